"""The scene file: text with line numbers, a module a section, the resolution to a model, the report of `check`."""
