/* The firmware: answers each observation with the decision of the controller, once, whatever happens to power or link. */
#include "board.h"
#include "controller.h"
#include "frame.h"
#include "link.h"
#include "store.h"

#include <string.h>

/* Payloads are the structures as they stand in memory, without gaps and with the lowest byte first. */
typedef char hil_observation_has_its_size[(sizeof(gl_observation) == HIL_OBSERVATION) ? 1 : -1];
typedef char hil_decision_has_its_size[(sizeof(gl_decision) == HIL_DECISION) ? 1 : -1];

static const uint8_t design[32] = {HIL_DESIGN};
static gl_workspace workspace;
static gl_observation observation;
static hil_memory memory;
static hil_decoder decoder;
static hil_frame received;
static hil_frame answer;
static uint8_t bytes[HIL_FRAME_MAX];
static uint8_t fresh[64];

static void send(uint8_t type, uint32_t sample, uint16_t length)
{
  answer.type = type;
  answer.session = memory.session;
  answer.sample = sample;
  answer.length = length;
  board_send(bytes, hil_encode(&answer, bytes));
}

/* Tell who this is and which sample comes next; `asked` is the number of the question, 0 if there was none. */
static void send_hello(uint32_t asked)
{
  (void)memcpy(answer.payload, design, sizeof(design));
  hil_put16(&answer.payload[32], HIL_OBSERVATION);
  hil_put16(&answer.payload[34], HIL_DECISION);
  hil_put32(&answer.payload[36], HIL_WATCHDOG_MS);
  hil_put32(&answer.payload[40], asked);
  send(HIL_TYPE_HELLO, memory.next, HIL_HELLO);
}

static void send_decision(void)
{
  (void)memcpy(answer.payload, (const uint8_t *)&memory.decision, sizeof(gl_decision));
  send(HIL_TYPE_DECISION, memory.next - 1U, HIL_DECISION);
}

/* Begin a session. One that is not newer than the present one is an old frame, and begins nothing. */
static void start(void)
{
  if (received.session > memory.session)
  {
    const uint32_t sequence = memory.sequence;
    (void)memset(&memory, 0, sizeof(memory));
    memory.sequence = sequence;
    memory.session = received.session;
    memory.next = received.sample;
    hil_keep(&memory);
  }
  send_hello(0U);
}

static void observe(void)
{
  if ((received.session != memory.session) || (received.length != HIL_OBSERVATION))
  {
    send_hello(0U);
  }
  else if (received.sample == memory.next)
  {
    (void)memcpy((uint8_t *)&observation, received.payload, sizeof(gl_observation));
    if (memory.answered == 0U)
    {
      gl_init(&workspace, &memory.state, &observation);
    }
    gl_step(&workspace, &memory.state, &observation, &memory.decision);
    memory.answered = 1U;
    memory.next++;
    hil_keep(&memory); /* before the answer: what was answered is never forgotten */
    send_decision();
  }
  else if ((memory.answered != 0U) && ((received.sample + 1U) == memory.next))
  {
    send_decision(); /* again: the answer was lost on its way */
  }
  else if (received.sample > memory.next)
  {
    send_hello(0U); /* samples before this one are missing here */
  }
  else
  {
    /* An old frame that was late on its way. */
  }
}

static void handle(void)
{
  switch (received.type)
  {
    case HIL_TYPE_ASK:
      send_hello(received.sample);
      break;
    case HIL_TYPE_START:
      start();
      break;
    case HIL_TYPE_OBSERVATION:
      observe();
      break;
    default:
      /* A frame for the other side, or of a later version. */
      break;
  }
}

int main(void)
{
  uint32_t refused = 0U;
  board_begin(HIL_WATCHDOG_MS);
  (void)memset(&decoder, 0, sizeof(decoder));
  (void)hil_load(&memory);
  send_hello(0U);
  for (;;)
  {
    const uint32_t count = board_receive(fresh, (uint32_t)sizeof(fresh));
    for (uint32_t i = 0U; i < count; i++)
    {
      hil_push(&decoder, fresh[i]);
      while (hil_next(&decoder, &received))
      {
        handle();
      }
    }
    if (decoder.refused != refused)
    {
      refused = decoder.refused;
      send_hello(0U); /* a damaged frame: the other side need not wait to learn of it */
    }
    board_feed();
  }
}
