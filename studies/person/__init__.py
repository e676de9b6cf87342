"""What growth explains of a person's folds: experiments on unfolded hemispheres."""
