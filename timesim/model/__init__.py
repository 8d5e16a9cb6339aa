"""What is simulated, in numbers: structure, contacts, excitation, start, and what a run need not model (no JAX)."""
