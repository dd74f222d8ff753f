"""The paper's equations 1-8: poses, lenses, triangulation and rectifying rotations."""
