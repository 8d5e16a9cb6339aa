"""One trajectory through its transitions: contact law, system, methods, dense output, guards and the event loop."""
