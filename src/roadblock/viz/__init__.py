"""Values to pictures: the overlay on the camera image, the bird's-eye view, and the files that hold them."""
