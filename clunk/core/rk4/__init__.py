"""The method of fixed-step RK4, with zero-crossing bisection."""
