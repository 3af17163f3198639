#include "dynamixel.h"

#include <string.h>

namespace hand {

namespace {

enum : uint8_t { kPing = 0x01, kRead = 0x02, kWrite = 0x03, kReboot = 0x08, kStatus = 0x55 };
constexpr uint8_t kHeader[] = {0xFF, 0xFF, 0xFD, 0x00};
constexpr size_t kParametersAt = 8;  // header, id, length, instruction
constexpr size_t kStatusOverhead = 11;
constexpr uint8_t kErrorBits = 0x7F;  // the uppermost one tells of a hardware error

// CRC-16, polynomial 0x8005, most significant bit first.
uint16_t crc(const uint8_t* data, size_t length) {
  uint16_t sum = 0;
  for (size_t i = 0; i < length; ++i) {
    sum ^= static_cast<uint16_t>(data[i]) << 8;
    for (int bit = 0; bit < 8; ++bit) sum = static_cast<uint16_t>(sum & 0x8000 ? sum << 1 ^ 0x8005 : sum << 1);
  }
  return sum;
}

// Makes every FF FF FD FD a FF FF FD again; returns the new length.
size_t unstuffed(uint8_t* data, size_t length) {
  size_t to = 0;
  for (size_t from = 0; from < length; ++from) {
    data[to++] = data[from];
    const bool is_escaped = to >= 3 && data[to - 3] == 0xFF && data[to - 2] == 0xFF && data[to - 1] == 0xFD;
    if (is_escaped && from + 1 < length && data[from + 1] == 0xFD) ++from;
  }
  return to;
}

}  // namespace

int32_t value_of(const uint8_t* data, uint8_t size) {
  uint32_t value = 0;
  for (uint8_t i = size; i > 0; --i) value = value << 8 | data[i - 1];
  return static_cast<int32_t>(value);
}

bool Dynamixel::ping(uint16_t* model) {
  uint8_t told[3];
  if (!ask(kPing, nullptr, 0, told, sizeof(told))) return false;
  *model = static_cast<uint16_t>(value_of(told, 2));
  return true;
}

bool Dynamixel::read(uint16_t address, uint8_t* data, uint8_t size) {
  const uint8_t parameters[] = {static_cast<uint8_t>(address), static_cast<uint8_t>(address >> 8), size, 0};
  return ask(kRead, parameters, sizeof(parameters), data, size);
}

bool Dynamixel::write(uint16_t address, int32_t value, uint8_t size) {
  uint8_t parameters[6] = {static_cast<uint8_t>(address), static_cast<uint8_t>(address >> 8)};
  for (uint8_t i = 0; i < size; ++i) parameters[2 + i] = static_cast<uint8_t>(static_cast<uint32_t>(value) >> 8 * i);
  return ask(kWrite, parameters, static_cast<uint8_t>(2 + size), nullptr, 0);
}

bool Dynamixel::reboot() { return ask(kReboot, nullptr, 0, nullptr, 0); }

bool Dynamixel::ask(uint8_t instruction, const uint8_t* parameters, uint8_t count, uint8_t* data, uint8_t size) {
  // Nothing is stuffed: what is written are small positive numbers, in which no FF FF FD occurs.
  uint8_t packet[kParametersAt + 6 + 2];
  memcpy(packet, kHeader, sizeof(kHeader));
  packet[4] = id_;
  packet[5] = static_cast<uint8_t>(count + 3);
  packet[6] = 0;
  packet[7] = instruction;
  if (count) memcpy(packet + kParametersAt, parameters, count);
  const size_t body = kParametersAt + count;
  const uint16_t sum = crc(packet, body);
  packet[body] = static_cast<uint8_t>(sum);
  packet[body + 1] = static_cast<uint8_t>(sum >> 8);
  wire_.send(packet, body + 2, kStatusOverhead + size);
  return answer(data, size);
}

bool Dynamixel::answer(uint8_t* data, uint8_t size) {
  uint8_t packet[kStatusOverhead + kLongestData + kLongestData / 3];
  size_t length = 0, whole = sizeof(packet);
  while (length < whole) {
    uint8_t byte;
    if (!wire_.receive(&byte)) return false;
    if (length < sizeof(kHeader) && byte != kHeader[length]) {
      // Noise, or the echo of a line without a switch; a third FF may still be followed by FD.
      length = byte != 0xFF ? 0 : length == 2 ? 2 : 1;
      continue;
    }
    packet[length++] = byte;
    if (length != kParametersAt - 1) continue;
    whole = kParametersAt - 1 + packet[5] + (static_cast<size_t>(packet[6]) << 8);
    if (whole < kStatusOverhead || whole > sizeof(packet)) return false;
  }
  const size_t body = whole - 2;
  if (crc(packet, body) != static_cast<uint16_t>(value_of(packet + body, 2))) return false;
  if (packet[4] != id_ || packet[7] != kStatus) return false;
  const size_t told = unstuffed(packet + kParametersAt, body - kParametersAt);
  if (told != static_cast<size_t>(size) + 1 || packet[kParametersAt] & kErrorBits) return false;
  if (size) memcpy(data, packet + kParametersAt + 1, size);
  return true;
}

}  // namespace hand
