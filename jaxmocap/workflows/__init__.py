"""The order of steps from files to files; no formula."""
