"""The search that knows no model.

`cost` scores simulated samples, `objective` is what a problem shows of itself, `genetic` breeds, `stopping`
says when to end, `progress` reports, `result` ranks and holds what was found, `store` writes it.
"""
