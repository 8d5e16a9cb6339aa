"""One contact under prescribed motion, in closed form state by state and by the event loop."""
