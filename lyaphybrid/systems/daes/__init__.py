"""Semi-linear differential–algebraic equations E(t) x' = f(t, x), and the elimination of algebraic variables."""
