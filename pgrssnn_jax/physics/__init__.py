"""Known physics of a system, as pure functions in physical units."""
