"""Evaluates predictions against a dataset that knows the truth of every object.

Standard judges give the numbers: pycocotools' COCOeval for instances, evo for trajectories;
confusion matrices and the usual seven depth errors are counted here. Each comes whole and in parts:
by distance, size, occlusion and light, which only a made dataset states for every object.
"""
