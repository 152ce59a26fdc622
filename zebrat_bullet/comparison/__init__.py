"""The paper's whole comparison: what to run, running it, and the tables that come of it."""
