// Runs the sketch: each line of standard input is a step, the answers and the hardware's state go to standard output.
//   say TEXT      a line of the host, with its checksum
//   wait MS       time passes, the loop runs every millisecond, the servo follows its goal
//   servo 0|1     it stops answering, or answers again
//   error BITS    its hardware error
//   stop 0|1      the emergency stop is released or pressed
#include "../../robot/firmware/hand_controller/hand_controller.ino"

#include <stdio.h>
#include <stdlib.h>

HardwareSerial Serial, Serial1;
Servo servo;
int pwm = -1, stop_pin = LOW;
static unsigned long now_ms = 1000;
unsigned long millis() { return now_ms; }

static void run_loop() {
  if (servo.answers) memcpy(servo.table + kPresentPosition, servo.table + kGoalPosition, 4);
  loop();
  Serial.out[Serial.out_end] = 0;
  fputs(Serial.out, stdout);
  Serial.out_end = 0;
}

int main() {
  int32_t closed = kClosedCount;
  memcpy(servo.table + kGoalPosition, &closed, 4);
  servo.table[kPresentTemperature] = 31;
  setup();
  char line[128];
  while (fgets(line, sizeof(line), stdin)) {
    line[strcspn(line, "\n")] = 0;
    const long value = strchr(line, ' ') ? atol(strchr(line, ' ')) : 0;
    if (!strncmp(line, "say ", 4)) {
      Serial.in_at = 0;
      Serial.in_end = static_cast<size_t>(
          snprintf(Serial.in, sizeof(Serial.in), "%s*%04X\n", line + 4, hand::crc16(line + 4, strlen(line + 4))));
      run_loop();
    } else if (!strncmp(line, "wait", 4)) {
      for (long i = 0; i < value; ++i, ++now_ms) run_loop();
    } else if (!strncmp(line, "servo", 5)) {
      servo.answers = value;
    } else if (!strncmp(line, "error", 5)) {
      servo.table[kHardwareError] = static_cast<uint8_t>(value);
    } else if (!strncmp(line, "stop", 4)) {
      stop_pin = value ? HIGH : LOW;
    }
    int32_t goal;
    memcpy(&goal, servo.table + kGoalPosition, 4);
    printf("goal %d motor %d\n", goal - closed, pwm);
  }
  return 0;
}
