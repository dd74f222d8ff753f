"""A small world with exact truth: solids, scenes, their ray-cast pictures, and what is true in them."""
