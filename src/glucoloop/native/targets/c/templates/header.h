#ifndef GL_CONTROLLER_H
#define GL_CONTROLLER_H

#include <stdbool.h>
#include <stdint.h>

@STRUCTURES@

/* Size of a saved state, in bytes: a mark, the digest of the design, the state, and a CRC-32. */
#define GL_RECORD_SIZE @SIZE@U

/* Set the state at the first observation; the first step may take the same observation. */
void gl_init(gl_workspace *workspace, gl_state *state, const gl_observation *observation);

/* Compute the dose until the next sample. It cannot fail, whatever the observation and the state are. */
void gl_step(gl_workspace *workspace, gl_state *state, const gl_observation *observation,
             gl_decision *decision);

/* Write the state to a record that survives a loss of power. */
void gl_save(const gl_state *state, uint8_t record[GL_RECORD_SIZE]);

/* Read a state back; false if the record is damaged or of another design, and the state is as it was. */
bool gl_restore(gl_state *state, const uint8_t record[GL_RECORD_SIZE]);

#endif
