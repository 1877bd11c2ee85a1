#include "controller.h"
@ANYTHING@static gl_workspace workspace;
static gl_state state;
static gl_observation observation;
static gl_decision decision;
int main(void)
{
@FILL@
  gl_step(&workspace, &state, &observation, &decision);
@BOUNDS@
  return 0;
}
