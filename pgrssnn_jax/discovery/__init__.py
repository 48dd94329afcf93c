"""From a physics and a record that disagree to the named effect that is missing, or to an honest no."""
