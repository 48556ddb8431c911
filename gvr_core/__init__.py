"""GVR-Bench's science: grounding by view retrieval in 3D Gaussian Splatting scenes.

The package works on numpy arrays (torch only inside model backends and the reference renderer)
and knows neither Prefect nor MLflow, so that it can be used as a library.
"""
