"""Fixed-step RK4 with zero-crossing bisection."""
