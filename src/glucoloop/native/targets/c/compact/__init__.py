"""The compact form: C with the loops and matrices of the traced function, constant tables and one workspace.

A traced function is put flat (`flat`): calls are looked into, constants carried out, what is computed twice computed
once. `arithmetic` says what each operation is, in NumPy and to the bit; `translate` writes the same in C; `memory`
gives each array of the workspace a place that others use when it is no longer needed.
"""
