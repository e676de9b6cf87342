"""Many subjects or many scenes, on Dask: each is measured on its own, then all go into tables and a group page."""
