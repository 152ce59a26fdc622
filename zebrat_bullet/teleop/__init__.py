"""A person drives in a browser, in real time, and every episode is recorded as any other driver's is."""
