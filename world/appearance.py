"""What only pictures show of a model: sky and light, and the maker's meshes."""

from __future__ import annotations

from pathlib import Path

import mujoco

from core.errors import InputError
from robot.robot import Robot

VISUAL_GROUP = 2


def add_sky_and_light(spec: mujoco.MjSpec) -> None:
    """A pale sky, one lamp that casts shadows and follows the root, and soft light from the camera."""
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=64, height=384)
    sky.builtin, sky.rgb1, sky.rgb2 = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, [0.70, 0.76, 0.83], [0.52, 0.61, 0.72]
    root = spec.worldbody.first_body()
    lamp = root.add_light(name="lamp", pos=[1.5, 1.0, 3.5], dir=[-0.4, -0.27, -0.95], castshadow=True)
    lamp.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    lamp.mode = mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM
    lamp.diffuse, lamp.specular, lamp.ambient = [0.50, 0.49, 0.47], [0.35, 0.35, 0.35], [0.0, 0.0, 0.0]
    headlight, visual = spec.visual.headlight, spec.visual
    headlight.ambient, headlight.diffuse, headlight.specular = [0.45, 0.46, 0.48], [0.20, 0.20, 0.20], [0.1, 0.1, 0.1]
    visual.rgba.haze = visual.rgba.fog = [0.70, 0.76, 0.83, 1]
    spec.stat.extent, visual.map.fogstart, visual.map.fogend = 2.0, 1.6, 5.0
    visual.map.shadowclip, visual.quality.shadowsize = 4.0, 2048
    visual.quality.numslices, visual.quality.numstacks = 20, 12


def strip_visuals(spec: mujoco.MjSpec) -> None:
    """Delete everything that physics does not see: shapes without contact, materials, textures, lights."""
    for geom in list(spec.geoms):
        if geom.contype == 0 and geom.conaffinity == 0:
            spec.delete(geom)
        else:
            geom.material = ""
    for items in (spec.meshes, spec.materials, spec.textures, spec.lights, spec.cameras):
        for item in list(items):
            spec.delete(item)


def add_meshes(spec: mujoco.MjSpec, robot: Robot, folder: Path) -> None:
    """Show the maker's meshes of ``folder`` in place of the shapes of the bodies that have one.

    A mesh takes the material of the first shape that it replaces. Raises InputError when the folder is
    missing or holds no mesh of this robot.
    """
    if not folder.is_dir():
        raise InputError("no such folder", where="meshes", got=folder, expected="a folder of STL files")
    found = [part for part in robot.meshes if (folder / part.file).is_file()]
    if not found:
        names = ", ".join(part.file for part in robot.meshes)
        raise InputError("no mesh of this robot", where="meshes", got=folder, expected=f"one or more of {names}")
    materials: dict[str, str] = {}
    for name in dict.fromkeys(part.body for part in found):
        shapes = [g for g in spec.body(name).geoms if g.group == VISUAL_GROUP]
        materials[name] = shapes[0].material if shapes else ""
        for geom in shapes:
            spec.delete(geom)
    for part in found:
        mesh = spec.add_mesh(name=part.file, file=str((folder / part.file).resolve()))
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.body(part.body).add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=part.file,
            pos=part.offset_m,
            mass=0,
            group=VISUAL_GROUP,
            contype=0,
            conaffinity=0,
            material=materials[part.body],
        )
