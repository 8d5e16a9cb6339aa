"""Harmonic balance: the contact law through a period, the residual, continuation, stability and response curves.

For others: `scheme.Scheme`, `curve.hbm_curve`, `branches.solutions_at`, `parameter.parameter_curve`, `branches`,
`convergence.convergence` and `stability.floquet_multipliers`; `continuation.follow` for any other residual.
"""
