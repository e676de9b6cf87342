"""The growth map with which a body folds like a person: what it takes, and what it does not say.

``growth_target`` makes maps from the heights of a person's folds, ``inference_runs`` plans bodies with them, without a
map, and with maps turned away from the person, each from several imperfections, and ``inference`` says from which
spread of growth on the folds stand where the person's do. The map would do; it is not how the person grew.
"""
