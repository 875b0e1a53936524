"""The search that knows no model.

`cost` scores simulated samples, `objective` is what a problem shows of itself, `algorithms` breeds, `engine`
runs, `stopping` says when to end, `memory` is what a run needs to be continued, `progress` reports, `history`
and `result` are what came out, `store` writes it.
"""
