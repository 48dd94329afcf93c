"""Discovery by inverse dynamics: of arms whose positions are measured well, the torque of every motion is compared."""
