#include "protocol.h"

#include <string.h>

namespace hand {

uint16_t crc16(const char* text, size_t length) {
  uint16_t crc = 0xFFFF;
  for (size_t i = 0; i < length; ++i) {
    crc ^= static_cast<uint16_t>(static_cast<uint8_t>(text[i])) << 8;
    for (int bit = 0; bit < 8; ++bit) {
      crc = static_cast<uint16_t>(crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1);
    }
  }
  return crc;
}

namespace {

constexpr int32_t kLargest = 10000000;  // no argument is as large as 10000

struct Scanner {
  const char* at;
  const char* end;

  bool done() const { return at == end; }

  // A decimal with up to three places, in thousandths.
  bool thousandths(int32_t* value) {
    int32_t number = 0;
    int digits = 0;
    int places = -1;
    for (; at != end && *at != ' '; ++at) {
      if (*at == '.') {
        if (places >= 0 || digits == 0) return false;
        places = 0;
      } else if (*at >= '0' && *at <= '9') {
        if (places == 3) return false;
        number = number * 10 + (*at - '0');
        ++digits;
        if (places >= 0) ++places;
        if (number >= kLargest) return false;
      } else {
        return false;
      }
    }
    if (digits == 0 || places == 0) return false;
    for (int place = places < 0 ? 0 : places; place < 3; ++place) {
      number *= 10;
      if (number >= kLargest) return false;
    }
    *value = number;
    return true;
  }

  bool sequence(uint16_t* value) {
    uint32_t number = 0;
    int digits = 0;
    for (; at != end && *at >= '0' && *at <= '9'; ++at, ++digits) {
      number = number * 10 + static_cast<uint32_t>(*at - '0');
      if (number > 0xFFFF) return false;
    }
    *value = static_cast<uint16_t>(number);
    return digits > 0;
  }

  bool blank() {
    if (at == end || *at != ' ') return false;
    ++at;
    return true;
  }

  bool word(const char* text) {
    const size_t length = strlen(text);
    if (static_cast<size_t>(end - at) < length || memcmp(at, text, length) != 0) return false;
    if (at + length != end && at[length] != ' ') return false;
    at += length;
    return true;
  }
};

struct Form {
  const char* word;
  Verb verb;
  int arguments;
};

constexpr Form kForms[] = {
    {"hello", Verb::kHello, 1}, {"ping", Verb::kPing, 0}, {"open", Verb::kOpen, 1},
    {"vibrate", Verb::kVibrate, 1}, {"close", Verb::kClose, 0}, {"step", Verb::kStep, 3},
    {"reset", Verb::kReset, 0}, {"point", Verb::kPoint, 3}, {"map", Verb::kMap, 2},
};

int hex(char digit) {
  if (digit >= '0' && digit <= '9') return digit - '0';
  if (digit >= 'A' && digit <= 'F') return digit - 'A' + 10;
  return -1;
}

bool checksum(const char* digits, uint16_t* value) {
  uint16_t number = 0;
  for (int i = 0; i < 4; ++i) {
    const int digit = hex(digits[i]);
    if (digit < 0) return false;
    number = static_cast<uint16_t>(number << 4 | digit);
  }
  *value = number;
  return true;
}

}  // namespace

bool parse(const char* line, size_t length, Command* command) {
  if (length < 6 || line[length - 5] != '*') return false;
  const size_t body = length - 5;
  if (!checksum(line + body + 1, &command->crc) || command->crc != crc16(line, body)) return false;
  Scanner scan{line, line + body};
  if (!scan.sequence(&command->sequence) || !scan.blank()) return false;
  command->verb = Verb::kUnknown;
  command->well_formed = true;
  for (const Form& form : kForms) {
    if (!scan.word(form.word)) continue;
    command->verb = form.verb;
    for (int i = 0; i < form.arguments; ++i) {
      command->well_formed =
          command->well_formed && scan.blank() && scan.thousandths(&command->arguments[i]);
    }
    command->well_formed = command->well_formed && scan.done();
    break;
  }
  return true;
}

bool LineReader::feed(char byte) {
  if (complete_) {
    length_ = 0;
    complete_ = too_long_ = false;
  }
  if (byte == '\n') {
    if (length_ > 0 && text_[length_ - 1] == '\r') --length_;
    complete_ = true;
    return !too_long_ && length_ > 0;
  }
  if (length_ == kLineLimit) {
    too_long_ = true;
  } else {
    text_[length_++] = byte;
  }
  return false;
}

void LineWriter::put(char byte) {
  if (length_ < kLineLimit) text_[length_++] = byte;
}

void LineWriter::blank() {
  if (length_ > 0) put(' ');
}

void LineWriter::word(const char* text) {
  blank();
  for (; *text; ++text) put(*text);
}

// A blank, the sign if it is a minus; returns the size without its sign.
uint32_t LineWriter::sign(int32_t value) {
  blank();
  if (value >= 0) return static_cast<uint32_t>(value);
  put('-');
  return 0u - static_cast<uint32_t>(value);
}

void LineWriter::digits(uint32_t number) {
  char reversed[10];
  int count = 0;
  do {
    reversed[count++] = static_cast<char>('0' + number % 10);
    number /= 10;
  } while (number > 0);
  while (count > 0) put(reversed[--count]);
}

void LineWriter::integer(int32_t value) { digits(sign(value)); }

void LineWriter::thousandths(int32_t value) {
  const uint32_t size = sign(value);
  digits(size / 1000);
  put('.');
  for (uint32_t place = 100; place > 0; place /= 10) put(static_cast<char>('0' + size / place % 10));
}

void LineWriter::finish() {
  const uint16_t crc = crc16(text_, length_);
  text_[length_++] = '*';
  for (int shift = 12; shift >= 0; shift -= 4) text_[length_++] = "0123456789ABCDEF"[crc >> shift & 0xF];
  text_[length_++] = '\n';
  text_[length_] = '\0';
}

}  // namespace hand
