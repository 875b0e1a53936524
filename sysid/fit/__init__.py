"""The search that knows no model.

`problem` states what a model offers to a fit, `nrmse` scores simulated samples, and `objective` scores
candidates. `breeders` propose candidates, `search` runs them, `stopping` ends a run, and `least_squares`
finishes it. `checkpoint` keeps finished stages; `progress` reports. `history`
and `result` are the outcome, and `store` writes it.
"""
