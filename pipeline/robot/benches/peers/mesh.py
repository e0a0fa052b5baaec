"""Draws one posed mesh scene with other renderers and times them: moderngl and pyrender on llvmpipe, Open3D ray casting.

Called by the bench `mesh` with a folder, the image size and the focal length. The folder holds `corners.f32` ([T, 3, 3],
camera frame, OpenCV axes, metres) and `links.u8` ([T]). Prints one line a peer, `NAME MEDIAN_MS BEST_MS PROCESSOR_MS PEAK_MIB` (mean
processor time of all threads), and writes NAME.depth (float32 camera z) and NAME.link (uint8, 255 = nothing) for comparison.
"""

import os
import resource
import statistics
import sys
import time

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
import numpy as np

folder, width, height, focal = sys.argv[1], int(float(sys.argv[2])), int(float(sys.argv[3])), float(sys.argv[4])
corners = np.fromfile(os.path.join(folder, "corners.f32"), np.float32).reshape(-1, 3)
links = np.fromfile(os.path.join(folder, "links.u8"), np.uint8)
NEAR, FAR = 0.01, 20.0


def report(name, draw, runs):
    draw()
    times = []
    processor = time.process_time()
    for _ in range(runs):
        start = time.perf_counter()
        depth, link = draw()
        times.append((time.perf_counter() - start) * 1e3)
    processor = (time.process_time() - processor) * 1e3 / runs
    np.ascontiguousarray(depth, np.float32).tofile(os.path.join(folder, name + ".depth"))
    np.ascontiguousarray(link, np.uint8).tofile(os.path.join(folder, name + ".link"))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{name} {statistics.median(times):.3f} {min(times):.3f} {processor:.3f} {memory:.0f}", flush=True)


def with_moderngl():
    import moderngl

    context = moderngl.create_standalone_context(backend="egl")
    program = context.program(
        vertex_shader="""#version 330
            in vec3 place; in float link; uniform mat4 clip_from_camera;
            flat out float flat_link; out float z;
            void main() { gl_Position = clip_from_camera * vec4(place, 1.0); flat_link = link; z = place.z; }""",
        fragment_shader="""#version 330
            flat in float flat_link; in float z; out vec2 result;
            void main() { result = vec2(z, flat_link); }""",
    )
    # Image row 0 becomes the lowest row of the frame buffer, which is read first.
    clip = np.array(
        [
            [2 * focal / width, 0, 0, 0],
            [0, 2 * focal / height, 0, 0],
            [0, 0, (FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)],
            [0, 0, 1, 0],
        ],
        np.float32,
    )
    program["clip_from_camera"].write(clip.T.tobytes())
    vertices = np.concatenate([corners, np.repeat(links, 3).astype(np.float32)[:, None]], 1)
    array = context.vertex_array(program, [(context.buffer(vertices.tobytes()), "3f 1f", "place", "link")])
    colour = context.renderbuffer((width, height), 2, dtype="f4")
    target = context.framebuffer([colour], context.depth_renderbuffer((width, height)))
    target.use()
    context.enable(moderngl.DEPTH_TEST)

    def draw():
        target.clear(0.0, 255.0, 0.0, 0.0, depth=1.0)
        array.render()
        pixels = np.frombuffer(target.read(components=2, dtype="f4"), np.float32).reshape(height, width, 2)
        return pixels[..., 0], pixels[..., 1].astype(np.uint8)

    report("moderngl", draw, 25)


def with_pyrender():
    import pyrender
    import trimesh

    turned = corners * np.array([1, -1, -1], np.float32)
    scene = pyrender.Scene()
    colours = {}
    for link in np.unique(links):
        chosen = turned.reshape(-1, 3, 3)[links == link].reshape(-1, 3)
        faces = np.arange(len(chosen)).reshape(-1, 3)
        mesh = pyrender.Mesh.from_trimesh(trimesh.Trimesh(chosen, faces, process=False), smooth=False)
        for primitive in mesh.primitives:
            primitive.material.doubleSided = True
        colours[scene.add(mesh)] = (int(link) + 1, 0, 0)
    scene.add(pyrender.IntrinsicsCamera(focal, focal, width / 2, height / 2, NEAR, FAR))
    renderer = pyrender.OffscreenRenderer(width, height)

    def draw():
        colour, depth = renderer.render(scene, flags=pyrender.RenderFlags.SEG, seg_node_map=colours)
        return depth, colour[..., 0] - np.uint8(1)

    report("pyrender", draw, 25)


def with_open3d():
    import open3d

    rows, columns = np.mgrid[0:height, 0:width] + 0.5
    rays = np.zeros((height, width, 6), np.float32)
    rays[..., 3], rays[..., 4], rays[..., 5] = (columns - width / 2) / focal, (rows - height / 2) / focal, 1
    rays = open3d.core.Tensor(rays)
    places = open3d.core.Tensor(corners)
    faces = open3d.core.Tensor(np.arange(len(corners), dtype=np.uint32).reshape(-1, 3))

    def build():
        scene = open3d.t.geometry.RaycastingScene(nthreads=2)
        scene.add_triangles(places, faces)
        return scene

    def cast(scene):
        answer = scene.cast_rays(rays, nthreads=2)
        depth, triangle = answer["t_hit"].numpy(), answer["primitive_ids"].numpy()
        hit = np.isfinite(depth)
        link = np.full(depth.shape, 255, np.uint8)
        link[hit] = links[triangle[hit]]
        return np.where(hit, depth, 0), link

    built = build()
    report("open3d-tree-built", lambda: cast(built), 15)
    report("open3d-tree-rebuilt", lambda: cast(build()), 9)


for peer in (with_moderngl, with_pyrender, with_open3d):
    try:
        peer()
    except Exception as error:  # a peer that is not installed must not hide the others
        print(f"{peer.__name__} does not run: {error}", file=sys.stderr)
