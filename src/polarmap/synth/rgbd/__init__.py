"""Polarization sequences made of RGB-D recordings: normals from depth, the picture as albedo, light and Fresnel.

`Shader` makes one frame's Stokes vectors, `render_rgbd` the frames of a sequence, `record_rgbd` writes them as files.
"""

from polarmap.synth.rgbd.conversion import record_rgbd, render_rgbd
from polarmap.synth.rgbd.models import BlinnPhong, Fresnel, Model
from polarmap.synth.rgbd.normals import plane_normals
from polarmap.synth.rgbd.shading import Shader

__all__ = ["BlinnPhong", "Fresnel", "Model", "Shader", "plane_normals", "record_rgbd", "render_rgbd"]
