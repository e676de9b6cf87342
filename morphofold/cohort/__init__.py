"""Many subjects or many scenes, on Dask: each measured on its own, then put into tables and a page of the group."""
