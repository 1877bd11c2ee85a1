"""Hardware in the loop: the patient on this computer, the controller on a chip, and a serial link between them.

Each module knows those before it: `protocol` (frames), `build` (the firmware), `link` (bytes to and from a chip),
`faults` (a link that is disturbed), `exchange` (a decision for each observation, or none) and `loop` (the whole run).
"""
