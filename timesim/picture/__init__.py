"""Pictures of results: one style, one module a study, and the function that draws the pictures of a run folder.

`PICTURES` of a module are the figures that a run writes. Each of its functions ``f(data, ax=None) -> ax`` draws one
aspect of a result, without axes on a figure of its own, which ``ax.figure.savefig(...)`` writes. Keywords choose what
is drawn by the names in the result; by default it is what moves or rubs most.
"""
