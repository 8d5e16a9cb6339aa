"""The peak of the response over frequency against a scalar, and the value where it is least."""
