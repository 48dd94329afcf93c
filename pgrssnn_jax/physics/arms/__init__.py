"""Robot arms: tables of numbers from a description or a URDF, two backends of forward dynamics, and the physics."""
