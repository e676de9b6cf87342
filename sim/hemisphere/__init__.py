"""A person's unfolded hemisphere as a body of bricks, and maps on spheres."""
