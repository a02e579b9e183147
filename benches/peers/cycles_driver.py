"""Renders one block of samples with Cycles on the CPU (PyPI: bpy, which is Blender as a module).

Null scattering, Cycles' unbiased mode, with everything off that would bias or filter: clamping,
adaptive sampling, denoising, light tree aside. Its cap on bounces is at the highest it takes, 1024.
Rendering counts from the first status that speaks of a sample: what comes before converts the grid.
"""
import math
import os
import tempfile

import numpy as np

import scene as common


def camera(bpy, scene):
    from mathutils import Matrix, Vector

    position, target, up = (Vector(scene.camera[k]) for k in ("position", "look_at", "up"))
    backward = (position - target).normalized()
    right = up.cross(backward).normalized()
    up = backward.cross(right)
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "VERTICAL"
    data.angle = math.radians(scene.camera["vertical_fov_degrees"])
    made = bpy.data.objects.new("camera", data)
    rows = [(right[i], up[i], backward[i], position[i]) for i in range(3)]
    made.matrix_world = Matrix((*rows, (0, 0, 0, 1)))
    return made


def lights(bpy, scene):
    from mathutils import Vector

    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (*scene.sky, 1)
    suns = []
    for given in scene.suns:
        # Energy is the irradiance on a facing plane, split into strength and colour.
        peak = max(given["irradiance"])
        data = bpy.data.lights.new("sun", "SUN")
        data.energy, data.angle = peak, 0
        data.color = [x / peak for x in given["irradiance"]]
        sun = bpy.data.objects.new("sun", data)
        sun.rotation_mode = "QUATERNION"
        sun.rotation_quaternion = Vector(given["direction_to_light"]).to_track_quat("Z", "Y")
        suns.append(sun)
    return world, suns


def volume(bpy, scene):
    data = bpy.data.volumes.new("cloud")
    data.filepath = str(scene.vdb)
    data.render.precision, data.render.clipping, data.render.space = "FULL", 0, "WORLD"
    material = bpy.data.materials.new("cloud")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeVolumePrincipled")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs["Volume"], output.inputs["Volume"])
    values = {
        "Color": (scene.albedo,) * 3 + (1,),
        # Absorption is then (1 - colour) times the density.
        "Absorption Color": (0, 0, 0, 1),
        "Density Attribute": scene.grid,
        "Density": scene.sigma_t_scale,
        "Anisotropy": scene.g,
        "Temperature Attribute": "",
        "Blackbody Intensity": 0,
        "Emission Strength": 0,
    }
    for name, value in values.items():
        shader.inputs[name].default_value = value
    data.materials.append(material)
    return bpy.data.objects.new("cloud", data)


def settings(target, args, resolution):
    render, cycles = target.render, target.cycles
    render.engine = "CYCLES"
    render.threads_mode, render.threads = "FIXED", args.threads
    render.resolution_x, render.resolution_y = resolution
    render.resolution_percentage = 100
    render.use_compositing = render.use_sequencer = False
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth = "32"
    target.view_settings.view_transform = "Raw"
    cycles.device, cycles.samples, cycles.seed = "CPU", args.spp, args.seed * 1_000_003 % 2**31
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_guiding = False
    cycles.volume_biased = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1
    for kind in ("", "diffuse_", "glossy_", "transmission_", "volume_", "transparent_max_"):
        setattr(cycles, "max_bounces" if not kind else f"{kind}bounces", 1024)


def main():
    args = common.arguments(__doc__.splitlines()[0])
    scene = common.read(args.scene)
    clock = common.Clock()
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    target = bpy.context.scene
    settings(target, args, scene.resolution)
    target.camera = camera(bpy, scene)
    target.world, suns = lights(bpy, scene)
    for made in (target.camera, volume(bpy, scene), *suns):
        target.collection.objects.link(made)

    first_sample = []

    def on_status(*status):
        if not first_sample and any("Sample" in str(part) for part in status):
            first_sample.append((common.Clock(), clock.read()))

    bpy.app.handlers.render_stats.append(on_status)
    with tempfile.TemporaryDirectory() as folder:
        target.render.filepath = os.path.join(folder, "image.exr")
        bpy.ops.render.render(write_still=True)
        if not first_sample:
            raise SystemExit("Cycles named no sample in its status: it cannot be timed")
        since, load = first_sample[0]
        rendered = since.read()
        written = bpy.data.images.load(target.render.filepath)
        written.colorspace_settings.name = "Linear Rec.709"
        width, height = written.size
        pixels = np.empty(width * height * written.channels, np.float32)
        written.pixels.foreach_get(pixels)
    image = pixels.reshape(height, width, -1)[::-1]
    common.finish(args.image, image, load, rendered, f"Cycles {bpy.app.version_string}")


if __name__ == "__main__":
    main()
