"""Pictures of results: one style, one module a study, and the table of what a run folder shows."""
