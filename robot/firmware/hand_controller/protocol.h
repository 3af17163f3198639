// The hand controller's line protocol, version 2: see docs/protocols/hand_controller.md.
// Plain C++11 without Arduino, heap or floating point: compiled for the board and for the host.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace hand {

constexpr int kProtocolVersion = 2;
constexpr size_t kLineLimit = 64;  // the longest line, without its end

// CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF, most significant bit first.
uint16_t crc16(const char* text, size_t length);

enum class Verb : uint8_t { kHello, kPing, kOpen, kVibrate, kClose, kStep, kReset, kPoint, kMap, kUnknown };

// One command. Numbers are thousandths of what was written: "1.25" mm is 1250, "0.3" s is 300.
struct Command {
  uint16_t sequence;
  Verb verb;
  bool well_formed;  // the arguments are as many and as they should be
  int32_t arguments[3];
  uint16_t crc;
};

// Reads a whole line without its end. False if it is none of ours: not ASCII, no or a wrong checksum,
// no sequence number. Such a line is not answered, as nobody knows who sent what.
bool parse(const char* line, size_t length, Command* command);

// Collects bytes into lines.
class LineReader {
 public:
  // True when `byte` has completed a line, which then is in text() and length().
  bool feed(char byte);
  const char* text() const { return text_; }
  size_t length() const { return length_; }

 private:
  char text_[kLineLimit];
  size_t length_ = 0;
  bool complete_ = false;
  bool too_long_ = false;
};

// Writes a line: words and numbers apart by one blank, then the checksum and the end.
class LineWriter {
 public:
  void word(const char* text);
  void integer(int32_t value);
  void thousandths(int32_t value);  // 1250 becomes 1.250
  // Adds checksum and end; the line is then in text(), zero-terminated.
  void finish();
  const char* text() const { return text_; }

 private:
  void blank();
  uint32_t sign(int32_t value);
  void digits(uint32_t number);
  void put(char byte);
  char text_[kLineLimit + 8] = {};
  size_t length_ = 0;
};

}  // namespace hand
