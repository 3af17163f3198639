// DYNAMIXEL Protocol 2.0, as far as one servo needs it: ping, read, write, reboot.
// Source: ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0". Plain C++11 without Arduino.
//
// Not ROBOTIS' library: its status read of one block overruns the 64 bytes of the core's receive buffer, its time-out
// does not know the baud rate, it does not compile for a board with one serial port, and no package registry has it.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace hand {

// A half-duplex line, with a servo that answers.
class Wire {
 public:
  virtual void begin(uint32_t baud) = 0;
  // Sends a packet, and gives an answer of so many bytes its time from there.
  virtual void send(const uint8_t* packet, size_t length, size_t answer_length) = 0;
  // The next byte of the answer; false when its time is over.
  virtual bool receive(uint8_t* byte) = 0;

 protected:
  ~Wire() = default;
};

constexpr size_t kLongestData = 40;  // whole answers stay below 64 bytes, stuffed ones too

class Dynamixel {
 public:
  Dynamixel(Wire& wire, uint8_t id) : wire_(wire), id_(id) {}

  // Each is true when the servo has answered, without an error. A latched hardware error is none here.
  bool ping(uint16_t* model);
  bool read(uint16_t address, uint8_t* data, uint8_t size);  // at most kLongestData
  bool write(uint16_t address, int32_t value, uint8_t size);
  bool reboot();

 private:
  bool ask(uint8_t instruction, const uint8_t* parameters, uint8_t count, uint8_t* data, uint8_t size);
  bool answer(uint8_t* data, uint8_t size);

  Wire& wire_;
  const uint8_t id_;
};

// Little-endian, as everything in a servo's table.
int32_t value_of(const uint8_t* data, uint8_t size);

}  // namespace hand
