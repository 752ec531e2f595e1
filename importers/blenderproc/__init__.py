"""Scenes of BlenderProc: BOP datasets, and its HDF5 files with states."""
