/* This computer as a board: the serial port is the standard input and output, a file is the non-volatile memory. */
#define _XOPEN_SOURCE 700

#include "board.h"
#include "emulated.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/time.h>
#include <unistd.h>

static int file;
static struct itimerval watchdog;

void power_off(void)
{
  _exit(2);
}

static void bark(int number)
{
  (void)number;
  _exit(3);
}

void file_open(void)
{
  file = open("nvm.bin", O_RDWR);
  if (file < 0)
  {
    _exit(4);
  }
}

void file_read(uint32_t offset, uint8_t bytes[], uint32_t size)
{
  if (pread(file, bytes, size, (off_t)offset) != (ssize_t)size)
  {
    _exit(4);
  }
}

void file_write(uint32_t offset, const uint8_t bytes[], uint32_t size)
{
  if (pwrite(file, bytes, size, (off_t)offset) != (ssize_t)size)
  {
    _exit(4);
  }
}

/* The watchdog counts the time that this process computes, so that a busy computer does not seem to be a hang. */
void board_begin(uint32_t watchdog_ms)
{
  emulated_begin();
  (void)signal(SIGVTALRM, bark);
  watchdog.it_value.tv_sec = (time_t)(watchdog_ms / 1000U);
  watchdog.it_value.tv_usec = (suseconds_t)((watchdog_ms % 1000U) * 1000U);
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
      _exit(0); /* the other side has gone */
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
      _exit(0);
    }
    sent += (uint32_t)count;
  }
}
