"""The search that knows no model.

`problem` states what a model offers to a fit and scores candidates, `nrmse` scores simulated samples.
`breeders` propose candidates, `search` runs them, `settings` ends a stage, `least_squares` finishes a run.
`checkpoint` keeps finished stages; `progress` reports. `history` and `result` are the outcome, and `store`
writes it.
"""
