"""A page on which a person draws a passage and watches a car drive through it."""
