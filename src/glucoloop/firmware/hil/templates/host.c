/* This computer as a board: the serial port is the standard input and output, a file is the non-volatile memory.
 *
 * If the standard error is a socket, it is the switch of the power: see supply(). */
#define _XOPEN_SOURCE 700

#include "board.h"
#include "emulated.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/wait.h>
#include <unistd.h>

#define SWITCH STDERR_FILENO
#define SLOWER 20U /* a chip is slower than this computer, at least so many times */

/* How the process of the chip ends. */
#define LEFT 0        /* the other side has gone */
#define POWER_FAILS 2 /* it is started again */
#define WATCHDOG 3    /* it is started again */
#define NO_FILE 4
#define NO_PROCESS 5

static int file;
static struct itimerval watchdog;

void power_fails(void)
{
  _exit(POWER_FAILS);
}

static void bark(int number)
{
  (void)number;
  _exit(WATCHDOG);
}

void file_read(uint32_t offset, uint8_t bytes[], uint32_t size)
{
  if (pread(file, bytes, size, (off_t)offset) != (ssize_t)size)
  {
    _exit(NO_FILE);
  }
}

void file_write(uint32_t offset, const uint8_t bytes[], uint32_t size)
{
  if (pwrite(file, bytes, size, (off_t)offset) != (ssize_t)size)
  {
    _exit(NO_FILE);
  }
}

/* Whether the switch asks for a reset; ends all if there is nobody at it any more. The words are those of QEMU. */
static bool reset_requested(pid_t chip)
{
  char words[256];
  const ssize_t got = read(SWITCH, words, sizeof(words) - 1U);
  if (got <= 0)
  {
    (void)kill(chip, SIGKILL);
    (void)waitpid(chip, NULL, 0);
    _exit(LEFT);
  }
  words[got] = '\0';
  return strstr(words, "system_reset") != NULL;
}

/* Start the chip as a process, and again when its power is cut at the switch or fails, or when its watchdog resets it.
 * Only the process of the chip returns from here. */
static void supply(void)
{
  static const char done[] = "{\"event\": \"RESET\", \"data\": {\"reason\": \"host-qmp-system-reset\"}}\n";
  bool reported = true;
  for (;;)
  {
    int life[2]; /* a pipe that closes when the chip ends */
    bool reset = false;
    int status = 0;
    pid_t chip;
    struct pollfd ends[2] = {{SWITCH, POLLIN, 0}, {0, POLLIN, 0}};
    if (pipe(life) != 0)
    {
      _exit(NO_PROCESS);
    }
    chip = fork();
    if (chip < 0)
    {
      _exit(NO_PROCESS);
    }
    if (chip == 0)
    {
      (void)close(SWITCH);
      (void)close(life[0]);
      return;
    }
    (void)close(life[1]);
    if (!reported)
    {
      reported = write(SWITCH, done, sizeof(done) - 1U) > 0;
    }
    ends[1].fd = life[0];
    while ((!reset) && (ends[1].revents == 0))
    {
      (void)poll(ends, 2, -1);
      reset = (ends[0].revents != 0) && reset_requested(chip);
    }
    (void)kill(chip, SIGKILL);
    (void)waitpid(chip, &status, 0);
    (void)close(life[0]);
    reported = !reset;
    if (WIFEXITED(status) && (WEXITSTATUS(status) != POWER_FAILS) && (WEXITSTATUS(status) != WATCHDOG))
    {
      _exit(WEXITSTATUS(status));
    }
  }
}

/* The watchdog counts the time that this process computes, so that a busy computer does not seem to be a hang. */
void board_begin(uint32_t watchdog_ms)
{
  struct stat is;
  const uint32_t limit_ms = watchdog_ms / SLOWER;
  if ((fstat(SWITCH, &is) == 0) && S_ISSOCK(is.st_mode))
  {
    supply();
  }
  file = open("nvm.bin", O_RDWR);
  emulated_begin();
  (void)signal(SIGVTALRM, bark);
  watchdog.it_value.tv_sec = (time_t)(limit_ms / 1000U);
  watchdog.it_value.tv_usec = (suseconds_t)((limit_ms % 1000U) * 1000U);
  board_feed();
}

void board_feed(void)
{
  (void)setitimer(ITIMER_VIRTUAL, &watchdog, NULL);
}

uint32_t board_receive(uint8_t bytes[], uint32_t most)
{
  struct pollfd in = {STDIN_FILENO, POLLIN, 0};
  ssize_t got = 0;
  if (poll(&in, 1, 100) > 0)
  {
    got = read(STDIN_FILENO, bytes, most);
    if (got <= 0)
    {
      _exit(LEFT);
    }
  }
  return (uint32_t)got;
}

void board_send(const uint8_t bytes[], uint32_t size)
{
  uint32_t sent = 0U;
  while (sent < size)
  {
    const ssize_t count = write(STDOUT_FILENO, &bytes[sent], size - sent);
    if (count <= 0)
    {
      _exit(LEFT);
    }
    sent += (uint32_t)count;
  }
}
