"""What a robot stands on: the floor."""

import mujoco

FLOOR_GEOM = "floor"


def add_floor(spec: mujoco.MjSpec) -> None:
    """An endless plane ``floor`` at z = 0 with friction 1, a checkerboard of 1 m squares."""
    pale, dark, edge = [0.80, 0.82, 0.85], [0.70, 0.73, 0.77], [0.55, 0.58, 0.63]
    texture = spec.add_texture(name="floor", type=mujoco.mjtTexture.mjTEXTURE_2D, width=256, height=256)
    texture.builtin, texture.rgb1, texture.rgb2 = mujoco.mjtBuiltin.mjBUILTIN_CHECKER, pale, dark
    texture.mark, texture.markrgb = mujoco.mjtMark.mjMARK_EDGE, edge
    material = spec.add_material(name="floor", texuniform=True, texrepeat=[1, 1])
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    spec.worldbody.add_geom(
        name=FLOOR_GEOM,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.05],
        friction=[1.0, 0.005, 0.0001],
        material="floor",
    )
