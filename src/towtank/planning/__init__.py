"""A day at the tank: the space there is, and the guard that keeps a vehicle off its walls."""
