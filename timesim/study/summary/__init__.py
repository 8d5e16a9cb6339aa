"""The summaries of studies, in words, each from its finished result: what the command prints."""
