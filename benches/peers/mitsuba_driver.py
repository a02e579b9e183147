"""Renders one block of samples with Mitsuba 3 (PyPI: mitsuba): scalar_rgb, volpath.

The scalar variant needs no compiler at run time and was the fastest on thick clouds. Mitsuba's
roulette is switched off: it also acts at null collisions with a survival of at most 0.95, which makes
the weights of long paths explode. Paths have no cap.
"""
import struct

import numpy as np

import scene as common


def read_box(path):
    """Returns the lowest and highest corner that the grid file names."""
    with open(path, "rb") as grid:
        header = grid.read(48)
    return np.array(struct.unpack("<6f", header[24:48])).reshape(2, 3)


def main():
    args = common.arguments(__doc__.splitlines()[0])
    scene = common.read(args.scene)
    clock = common.Clock()
    import drjit
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    drjit.set_thread_count(args.threads)
    mi.Thread.thread().logger().set_log_level(mi.LogLevel.Error)
    transform = mi.ScalarTransform4f()
    grid = str(args.export / "density.vol")
    low, high = read_box(grid)
    unit_cube = transform.translate(low.tolist()).scale((high - low).tolist())
    cube = transform.translate(((low + high) / 2).tolist()).scale(((high - low) / 2).tolist())
    camera, (width, height) = scene.camera, scene.resolution
    phase = {"type": "hg", "g": scene.g} if scene.g else {"type": "isotropic"}
    extinction = {"type": "gridvolume", "filename": grid, "to_world": unit_cube, "raw": True}
    world = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": -1, "rr_depth": 1_000_000},
        "sensor": {
            "type": "perspective",
            "fov": camera["vertical_fov_degrees"],
            "fov_axis": "y",
            "to_world": transform.look_at(
                origin=camera["position"], target=camera["look_at"], up=camera["up"]
            ),
            "film": {
                "type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb",
                "component_format": "float32", "rfilter": {"type": "box"},
            },
            "sampler": {"type": "independent"},
        },
        "cloud": {
            "type": "cube",
            "to_world": cube,
            "bsdf": {"type": "null"},
            "interior": {
                "type": "heterogeneous", "sigma_t": extinction, "scale": scene.sigma_t_scale,
                "albedo": scene.albedo, "phase": phase,
            },
        },
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": scene.sky}},
    }
    for i, sun in enumerate(scene.suns):
        world[f"sun{i}"] = {
            "type": "directional",
            "direction": [-x for x in sun["direction_to_light"]],
            "irradiance": {"type": "rgb", "value": sun["irradiance"]},
        }
    loaded = mi.load_dict(world)
    load = clock.read()

    clock = common.Clock()
    # Far apart: the stream of a pixel is offset by its place.
    image = np.array(mi.render(loaded, spp=args.spp, seed=args.seed * 1_000_003))
    common.finish(args.image, image, load, clock.read(), f"Mitsuba {mi.__version__}")


if __name__ == "__main__":
    main()
