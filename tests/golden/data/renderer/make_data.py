"""Make lit_shapes.npz with Blender's Cycles; see README.md. Run in an environment of its own, never by the tests."""

import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np

WIDTH, HEIGHT, FOCAL_PX, CROP = 1280, 720, 948.0, 40
SAMPLES = 1024

# kind, centre in camera axes (x right, y down, z forward) in m, radius in m, normal in camera axes
SHAPES = [
    ("disc", (0.000, 0.000, 0.80), 0.0060, (0.0, 0.0, -1.0)),
    ("disc", (0.1013, -0.0571, 0.80), 0.0110, (0.3, 0.2, -1.0)),
    ("disc", (-0.3307, 0.2003, 0.75), 0.0100, (0.5, -0.6, -1.0)),
    ("disc", (0.4409, 0.2511, 0.80), 0.0120, (-0.9, 0.1, -1.0)),
    ("disc", (0.0551, 0.1217, 0.40), 0.0065, (0.0, -0.8, -1.0)),
    ("sphere", (0.0007, 0.0003, 0.80), 0.0050, (0.0, 0.0, -1.0)),
    ("sphere", (0.2111, -0.1309, 0.60), 0.0090, (0.0, 0.0, -1.0)),
    ("sphere", (-0.4703, -0.2605, 0.80), 0.0120, (0.0, 0.0, -1.0)),
    ("sphere", (0.2503, 0.1404, 0.42), 0.0060, (0.0, 0.0, -1.0)),
    ("sphere", (-0.1202, 0.0901, 0.30), 0.0042, (0.0, 0.0, -1.0)),
]


def blender(v):
    """Blender's camera looks along -z with y up."""
    return (v[0], -v[1], -v[2])


def prepare():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = SAMPLES
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.max_bounces = 0
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = WIDTH, HEIGHT, 100
    scene.render.use_border = scene.render.use_crop_to_border = True
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.view_settings.view_transform = "Raw"
    world = bpy.data.worlds.new("dark")
    scene.world = world
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    data = bpy.data.cameras.new("camera")
    data.sensor_fit, data.sensor_width = "HORIZONTAL", 36.0
    data.lens = FOCAL_PX / WIDTH * 36.0
    data.clip_start = 0.01
    camera = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(camera)
    scene.camera = camera
    return scene


def glow():
    material = bpy.data.materials.new("glow")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    emission, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    emission.inputs["Strength"].default_value = 1.0
    links.new(emission.outputs[0], output.inputs[0])
    return material


def add_shape(kind, centre, radius, normal, material):
    import mathutils

    place = blender(centre)
    if kind == "disc":
        turn = mathutils.Vector(blender(normal)).to_track_quat("Z", "Y").to_euler()
        bpy.ops.mesh.primitive_circle_add(vertices=2048, radius=radius, fill_type="NGON", location=place, rotation=turn)
    else:
        bpy.ops.mesh.primitive_uv_sphere_add(segments=256, ring_count=128, radius=radius, location=place)
    shape = bpy.context.object
    shape.data.materials.append(material)
    return shape


def main(path):
    scene, material = prepare(), glow()
    crops, corners = [], []
    file = Path(tempfile.mkdtemp()) / "crop.exr"
    for kind, centre, radius, normal in SHAPES:
        shape = add_shape(kind, centre, radius, normal, material)
        u = FOCAL_PX * centre[0] / centre[2] + (WIDTH - 1) / 2
        v = FOCAL_PX * centre[1] / centre[2] + (HEIGHT - 1) / 2
        i, j = round(u) - CROP // 2, round(v) - CROP // 2
        r = scene.render
        r.border_min_x, r.border_max_x = (i + 1e-3) / WIDTH, (i + CROP + 1e-3) / WIDTH
        r.border_min_y, r.border_max_y = 1 - (j + CROP - 1e-3) / HEIGHT, 1 - (j - 1e-3) / HEIGHT
        r.filepath = str(file)
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(str(file))
        image.colorspace_settings.name = "Non-Color"
        pixels = np.array(image.pixels[:], np.float32).reshape(image.size[1], image.size[0], -1)[::-1, :, 0]
        assert pixels.shape == (CROP, CROP), pixels.shape
        bpy.data.images.remove(image)
        bpy.data.objects.remove(shape)
        crops.append(pixels.astype(np.float16))
        corners.append((i, j))
    np.savez_compressed(
        path,
        crops=np.array(crops),
        corner_px=np.array(corners),
        kind=np.array([s[0] for s in SHAPES]),
        centre_m=np.array([s[1] for s in SHAPES]),
        radius_m=np.array([s[2] for s in SHAPES]),
        normal=np.array([s[3] for s in SHAPES]),
        size_px=np.array([WIDTH, HEIGHT]),
        focal_px=FOCAL_PX,
    )


if __name__ == "__main__":
    main(sys.argv[1])
