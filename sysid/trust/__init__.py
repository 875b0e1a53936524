"""How far a fit can be trusted: before it, after it, and on trials that it has not seen.

Knows no model: a `sysid.fit.problem.Problem` turns points of the unit cube into residuals. From these follow
derivatives (`problem`), what noise leaves open (`linearized`), profiles of the cost (`profiles`), fits of
resampled trials (`assessment`), verdicts, and what to record next (`sensitivity`).
"""
