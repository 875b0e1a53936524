"""How far a fit can be trusted: before it, after it, and on a drop that it has not seen.

Knows no model: a fit is a `problem.Problem`, which turns points of the unit cube into residuals. From these
come the sensitivities (`jacobian`), what noise leaves open (`fisher`), profiles of the cost (`profiles`),
fits of resampled trials (`resampling`), verdicts in words (`verdicts`) and what to record next
(`candidates`).
"""
