// The SCU-Hand-SV's controller: board, wiring and ids are in robot/hardware/README.md.
//
// The host speaks through USB at 115200 baud, the valve's servo through Serial1. Nothing here but pins, the servo's
// line, the memory and the watchdog: protocol and behaviour are in the .cpp files.
#include <avr/eeprom.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

#include "controller.h"
#include "pins.h"

#ifndef HAVE_HWSERIAL1
#error "The hand controller needs a board with a serial port besides the one to the computer: a Mega 2560, a Leonardo or a Micro. An Uno or Nano has only one."
#endif

namespace {

// Sleep until something comes, or for a millisecond, if nothing is here yet: nothing can come in between. The counter of
// the milliseconds, both lines and the watchdog go on.
void sleep_unless_heard(Stream& line) {
  noInterrupts();
  if (line.available() > 0) {
    interrupts();
    return;
  }
  sleep_enable();
  interrupts();
  sleep_cpu();
  sleep_disable();
}

// The longest return delay of a servo, and what it takes it to begin and the line to turn round.
constexpr uint32_t kServoBeginsUs = 510 + 1000;

class HalfDuplex : public hand::Wire {
 public:
  void begin(uint32_t baud) override {
    pinMode(kDirectionPin, OUTPUT);
    digitalWrite(kDirectionPin, LOW);
    Serial1.begin(baud);
    byte_ns_ = 10000000000ULL / baud;
  }

  void send(const uint8_t* packet, size_t length, size_t answer_length) override {
    while (Serial1.available() > 0) Serial1.read();  // what came too late
    digitalWrite(kDirectionPin, HIGH);
    Serial1.write(packet, length);
    Serial1.flush();
    digitalWrite(kDirectionPin, LOW);
    sent_us_ = micros();
    // A third more, if every three bytes are stuffed.
    allowed_us_ = kServoBeginsUs + (answer_length + answer_length / 3) * byte_ns_ / 1000;
  }

  bool receive(uint8_t* byte) override {
    while (Serial1.available() == 0) {
      if (micros() - sent_us_ > allowed_us_) return false;
      sleep_unless_heard(Serial1);
    }
    *byte = static_cast<uint8_t>(Serial1.read());
    return true;
  }

 private:
  uint32_t byte_ns_ = 0;
  uint32_t sent_us_ = 0;
  uint32_t allowed_us_ = 0;
};

struct Stored {
  hand::ValveMap map;
  uint16_t crc;

  uint16_t sum() const { return hand::crc16(reinterpret_cast<const char*>(&map), sizeof(map)); }
};

Stored EEMEM stored_map;

class Pins : public hand::Board {
 public:
  void begin() {
    pinMode(kVibrationPin, OUTPUT);
    analogWrite(kVibrationPin, 0);
    pinMode(kEmergencyStopPin, INPUT_PULLUP);
  }

  void vibrate(int32_t permille) override { analogWrite(kVibrationPin, static_cast<int>(permille * 255 / 1000)); }
  bool emergency_stop_is_pressed() override { return digitalRead(kEmergencyStopPin) == HIGH; }

  bool load(hand::ValveMap* map) override {
    Stored stored;
    eeprom_read_block(&stored, &stored_map, sizeof(stored));
    *map = stored.map;
    return stored.crc == stored.sum();
  }

  // Up to 4 ms for each byte that changes. The valve is shut meanwhile.
  void store(const hand::ValveMap& map) override {
    Stored stored = {map, 0};
    stored.crc = stored.sum();
    for (size_t i = 0; i < sizeof(stored); ++i) {
      wdt_reset();
      eeprom_update_byte(reinterpret_cast<uint8_t*>(&stored_map) + i, reinterpret_cast<const uint8_t*>(&stored)[i]);
    }
  }
};

HalfDuplex wire;
Pins pins;
hand::Controller controller(pins, wire);
hand::LineReader reader;

}  // namespace

void setup() {
  MCUSR = 0;  // a watchdog that has bitten stays on, at its shortest, until this is cleared
  wdt_enable(WDTO_120MS);
  pins.begin();
  Serial.begin(115200);
}

void loop() {
  wdt_reset();
  const uint32_t now_ms = millis();
  controller.tick(now_ms);
  while (Serial.available() > 0) {
    if (!reader.feed(static_cast<char>(Serial.read()))) continue;
    hand::LineWriter reply;
    if (controller.take(reader.text(), reader.length(), now_ms, &reply)) Serial.print(reply.text());
  }
  sleep_unless_heard(Serial);
}
