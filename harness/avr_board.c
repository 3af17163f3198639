/* A board with an AVR in simavr, for `harness/avr_board.py`: bytes in and out of two serial ports, pins, memory.
 *
 * Bytes go into a port one per byte-time, as on a line: all at once they would overrun the chip's two-byte buffer. */
#include <simavr/avr_extint.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdlib.h>
#include <string.h>

#define PORTS 2
#define QUEUE 4096
#define PACKET_ENDS 1600   /* cycles without a byte: 0.1 ms, less than a servo's return delay */
#define EXTERNAL_INTERRUPTS 8 /* not used */
#define SERVO 1            /* the servo's line, */
#define DIRECTION 'E', 4   /* which the board has while this pin of a Mega, its pin 2, is high */
#define UCSR1A 0xC8        /* of an ATmega2560, with three of its bits and of the next register's */
#define UCSR1B 0xC9
#define ALL_IS_SENT 0x40
#define BUFFER_IS_EMPTY 0x20
#define BUFFER_IS_FED 0x20

typedef struct board_t board_t;

typedef struct port_t {
  board_t *board;
  avr_irq_t *input;
  char name;
  uint8_t in[QUEUE], out[QUEUE];
  size_t in_at, in_end, out_end;
  uint32_t byte_cycles; /* of what comes in */
  avr_cycle_count_t sent_at;
} port_t;

struct board_t {
  avr_t *avr;
  unsigned long against_the_switch; /* bytes on the servo's line that its direction pin did not let through */
  port_t ports[PORTS];
};

int board_pin(board_t *board, char letter, int bit) {
  avr_ioport_state_t state;
  avr_ioctl(board->avr, AVR_IOCTL_IOPORT_GETSTATE(letter), &state);
  return state.port >> bit & 1;
}

static void look_at_switch(port_t *port, int sends) {
  if (port == &port->board->ports[SERVO] && board_pin(port->board, DIRECTION) != sends)
    ++port->board->against_the_switch;
}

static avr_cycle_count_t next_byte(avr_t *avr, avr_cycle_count_t when, void *param) {
  port_t *port = param;
  if (port->in_at == port->in_end) return 0;
  look_at_switch(port, 0);
  avr_raise_irq(port->input, port->in[port->in_at++ % QUEUE]);
  return port->in_at == port->in_end ? 0 : when + port->byte_cycles;
}

/* A chip that sleeps is to be looked at then. */
static avr_cycle_count_t wake(avr_t *avr, avr_cycle_count_t when, void *param) { return 0; }

static void sent(avr_irq_t *irq, uint32_t value, void *param) {
  port_t *port = param;
  look_at_switch(port, 1);
  port->sent_at = port->board->avr->cycle;
  avr_cycle_timer_register(port->board->avr, PACKET_ENDS + 1, wake, port);
  if (port->out_end < QUEUE) port->out[port->out_end++] = (uint8_t)value;
}

/* A chip that sleeps does not wait for the day to pass. */
static void sleep_at_once(avr_t *avr, avr_cycle_count_t cycles) {}

/* Stop the timers of the PWM pins: nobody looks at these pins, and simavr, which has no top for their mode, would have
 * each overflow at every count. */
static void stop_pwm(avr_t *avr) {
  static const uint16_t clocks[] = {0x81, 0xB1, 0x91, 0xA1, 0x121}; /* TCCR1B to TCCR5B of an ATmega2560 */
  for (size_t i = 0; i < sizeof(clocks) / sizeof(*clocks); ++i) {
    const avr_io_addr_t io = AVR_DATA_TO_IO(clocks[i]);
    if (avr->data[clocks[i]] & 7) avr->io[io].w.c(avr, clocks[i], avr->data[clocks[i]] & ~7, avr->io[io].w.param);
  }
}

/* A level interrupt whose pin is low would be looked at in every cycle. A reset, the watchdog's too, turns that on again. */
static void stop_level_interrupts(avr_t *avr) {
  for (int i = 0; i < EXTERNAL_INTERRUPTS; ++i) avr_extint_set_strict_lvl_trig(avr, i, 0);
}

/* simavr may take a byte for sent while the chip still writes it: the chip then clears the flag that tells of its end, and
 * waits for it for ever. A real byte takes its time. */
static void end_packet(board_t *board) {
  uint8_t *const a = &board->avr->data[UCSR1A], b = board->avr->data[UCSR1B];
  if (*a & BUFFER_IS_EMPTY && !(b & BUFFER_IS_FED)) *a |= ALL_IS_SENT;
}

static void quiet(avr_t *avr, const int level, const char *format, va_list list) {}

/* NULL for a file or a chip that cannot be used. */
board_t *board_new(const char *elf, const char *chip) {
  avr_global_logger_set(quiet);
  elf_firmware_t firmware = {0};
  if (elf_read_firmware(elf, &firmware) != 0) return NULL;
  board_t *board = calloc(1, sizeof(board_t));
  board->avr = avr_make_mcu_by_name(chip);
  if (!board->avr) return NULL;
  avr_init(board->avr);
  board->avr->log = LOG_NONE;
  board->avr->sleep = sleep_at_once;
  firmware.frequency = 16000000;
  avr_load_firmware(board->avr, &firmware);
  for (int i = 0; i < PORTS; ++i) {
    port_t *port = &board->ports[i];
    port->board = board;
    port->name = (char)('0' + i);
    uint32_t flags = 0;
    avr_ioctl(board->avr, AVR_IOCTL_UART_SET_FLAGS(port->name), &flags);
    port->input = avr_io_getirq(board->avr, AVR_IOCTL_UART_GETIRQ(port->name), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(board->avr, AVR_IOCTL_UART_GETIRQ(port->name), UART_IRQ_OUTPUT), sent, port);
  }
  return board;
}

void board_free(board_t *board) {
  avr_terminate(board->avr);
  free(board);
}

/* Run for so many cycles, or until a packet to the servo is over; the cycles that it took, 0 if the chip has stopped
 * for good. */
uint32_t board_run(board_t *board, uint32_t cycles) {
  const avr_cycle_count_t begin = board->avr->cycle;
  const port_t *servo = &board->ports[SERVO];
  stop_pwm(board->avr);
  stop_level_interrupts(board->avr);
  avr_cycle_timer_register(board->avr, cycles, wake, board);
  while (board->avr->cycle - begin < cycles) {
    const int state = avr_run(board->avr);
    if (state == cpu_Done || state == cpu_Crashed) return 0;
    if (servo->out_end && board->avr->cycle - servo->sent_at > PACKET_ENDS) {
      end_packet(board);
      break;
    }
  }
  return (uint32_t)(board->avr->cycle - begin);
}

/* Bytes that come into a port from now on, one every `byte_cycles`. */
void board_feed(board_t *board, int index, const uint8_t *data, size_t length, uint32_t byte_cycles) {
  port_t *port = &board->ports[index];
  const int idle = port->in_at == port->in_end;
  port->byte_cycles = byte_cycles;
  for (size_t i = 0; i < length; ++i) port->in[port->in_end++ % QUEUE] = data[i];
  if (idle && length) avr_cycle_timer_register(board->avr, byte_cycles, next_byte, port);
}

/* What a port has sent since the last call; `data` holds 4096 bytes. */
size_t board_sent(board_t *board, int index, uint8_t *data) {
  port_t *port = &board->ports[index];
  const size_t length = port->out_end;
  memcpy(data, port->out, length);
  port->out_end = 0;
  return length;
}

/* Hold an input at a level from outside, against the chip's own pull-up. */
void board_set_pin(board_t *board, char letter, int bit, int level) {
  avr_ioport_external_t external = {.name = letter, .mask = 1 << bit, .value = (level != 0) << bit};
  avr_ioctl(board->avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(letter), &external);
  avr_raise_irq(avr_io_getirq(board->avr, AVR_IOCTL_IOPORT_GETIRQ(letter), bit), (uint32_t)level);
}

unsigned long board_against_the_switch(board_t *board) { return board->against_the_switch; }
uint8_t board_memory(board_t *board, uint16_t address) { return board->avr->data[address]; }
void board_poke(board_t *board, uint16_t address, uint8_t value) { board->avr->data[address] = value; }
void board_jump(board_t *board, uint32_t address) { board->avr->pc = address; }
void board_reset(board_t *board) { avr_reset(board->avr); }
