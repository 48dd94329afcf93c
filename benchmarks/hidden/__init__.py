"""Systems with hidden effects, written from the physical meaning alone: test data for whatever is to name them.

No effect, no integrator and no parameter of the simulators here comes from the library; from it come the base physics
that a tool is given, the form of a record, and the arm's link tables and motion plans.
"""
