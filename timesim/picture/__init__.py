"""Pictures of results: one style, one module a study, and the table of what a run folder shows.

`PICTURES` of a module are the figures that a run writes. The functions beside it draw one aspect of a result each,
``f(data, ax=None) -> ax``: without axes on a figure of their own, which ``ax.figure.savefig(...)`` writes. Keywords
choose what is drawn, by the names in the result; by default what moves or rubs most.
"""
