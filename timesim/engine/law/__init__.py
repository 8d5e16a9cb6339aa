"""Contact laws: the interface that the event loop asks, the law of the cone, and the table of all laws."""
