"""Rendering of Gaussians: one protocol, a CPU and a CUDA backend, and their slow torch oracle."""

from gvr_core.rendering.base import Renderer, Rendering, get_renderer

__all__ = ["Renderer", "Rendering", "get_renderer"]
