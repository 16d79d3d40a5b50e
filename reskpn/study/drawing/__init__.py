"""Pictures and tables, out of results alone."""
