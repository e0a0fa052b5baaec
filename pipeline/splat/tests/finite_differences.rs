//! Gradients against central differences of a slow, independent float64 renderer written straight from the formulas.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common {
    pub(crate) mod random;
    pub(crate) mod room;
}

use common::{random, room};
use rogs_splat::{
    Colour, Gaussians, Mode, RasterCamera, RasterConfig, RenderGradient, backward, backward_with_screen,
    render_with_tape,
};

/// All inputs of a render as one vector of float64, in this order; last, what is added to the centres in the image.
struct Layout {
    n: usize,
    degree: Option<usize>,
    extra: usize,
}

impl Layout {
    fn parts(&self) -> [(&'static str, usize); 10] {
        let colour = self.degree.map_or(3, |d| 3 * (d + 1) * (d + 1));
        [
            ("means", 3 * self.n),
            ("quats", 4 * self.n),
            ("scales", 3 * self.n),
            ("opacities", self.n),
            ("colour", colour * self.n),
            ("extra", self.extra * self.n),
            ("camera rotation", 9),
            ("camera translation", 3),
            ("background", 3),
            ("centres in the image", 2 * self.n),
        ]
    }

    fn split<'a>(&self, all: &'a [f64]) -> Vec<&'a [f64]> {
        let mut rest = all;
        self.parts()
            .iter()
            .map(|&(_, length)| {
                let (head, tail) = rest.split_at(length);
                rest = tail;
                head
            })
            .collect()
    }
}

/// Weights of the outputs in the loss: rgb, alpha, depth accumulated, depth expected, extra accumulated, extra.
struct Weights([Vec<f32>; 6]);

fn loss(layout: &Layout, all: &[f64], camera: &RasterCamera, config: &RasterConfig, weights: &Weights) -> f64 {
    let parts = layout.split(all);
    let [means, quats, scales, opacities, colours, extra, r, t, background, shift] = parts[..] else {
        panic!()
    };
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    let (fx, fy, cx, cy) = (
        camera.fx as f32 as f64,
        camera.fy as f32 as f64,
        camera.cx as f32 as f64,
        camera.cy as f32 as f64,
    );
    let eps = f64::from(config.eps2d);
    struct Splat {
        m: [f64; 2],
        conic: [f64; 3],
        opacity: f64,
        z: f64,
        rgb: [f64; 3],
        index: usize,
    }
    let mut splats = Vec::new();
    for i in 0..layout.n {
        let mu = &means[3 * i..3 * i + 3];
        let p: Vec<f64> = (0..3)
            .map(|k| (0..3).map(|j| r[3 * k + j] * mu[j]).sum::<f64>() + t[k])
            .collect();
        if p[2] < f64::from(config.near) || p[2] > f64::from(config.far) {
            continue;
        }
        let norm = quats[4 * i..4 * i + 4].iter().map(|q| q * q).sum::<f64>().sqrt();
        let q: Vec<f64> = quats[4 * i..4 * i + 4].iter().map(|q| q / norm).collect();
        let (a, b, c, d) = (q[0], q[1], q[2], q[3]);
        let rq = [
            [
                1.0 - 2.0 * (c * c + d * d),
                2.0 * (b * c - a * d),
                2.0 * (b * d + a * c),
            ],
            [
                2.0 * (b * c + a * d),
                1.0 - 2.0 * (b * b + d * d),
                2.0 * (c * d - a * b),
            ],
            [
                2.0 * (b * d - a * c),
                2.0 * (c * d + a * b),
                1.0 - 2.0 * (b * b + c * c),
            ],
        ];
        let mut sigma = [[0.0; 3]; 3];
        for x in 0..3 {
            for y in 0..3 {
                sigma[x][y] = (0..3).map(|k| rq[x][k] * rq[y][k] * scales[3 * i + k].powi(2)).sum();
            }
        }
        let clamp =
            |v: f64, c: f64, f: f64, size: f64| v.clamp(-c / f - 0.15 * size / f, (size - c) / f + 0.15 * size / f);
        let (ux, uy) = (clamp(p[0] / p[2], cx, fx, w), clamp(p[1] / p[2], cy, fy, h));
        let j = [[fx / p[2], 0.0, -fx * ux / p[2]], [0.0, fy / p[2], -fy * uy / p[2]]];
        let mut jr = [[0.0; 3]; 2];
        for x in 0..2 {
            for y in 0..3 {
                jr[x][y] = (0..3).map(|k| j[x][k] * r[3 * k + y]).sum();
            }
        }
        let s2 = |x: usize, y: usize| -> f64 {
            (0..3)
                .flat_map(|k| (0..3).map(move |l| (k, l)))
                .map(|(k, l)| jr[x][k] * sigma[k][l] * jr[y][l])
                .sum()
        };
        let (a0, c0, b0) = (s2(0, 0), s2(1, 1), s2(0, 1));
        let det = (a0 + eps) * (c0 + eps) - b0 * b0;
        let mut opacity = opacities[i];
        if config.mode == Mode::Antialiased {
            opacity *= ((a0 * c0 - b0 * b0) / det)
                .max(f64::from(config.min_compensation).powi(2))
                .sqrt();
        }
        let rgb = match layout.degree {
            None => [colours[3 * i], colours[3 * i + 1], colours[3 * i + 2]],
            Some(degree) => {
                let o: Vec<f64> = (0..3)
                    .map(|k| -(0..3).map(|l| r[3 * l + k] * t[l]).sum::<f64>())
                    .collect();
                let v: Vec<f64> = (0..3).map(|k| mu[k] - o[k]).collect();
                let length = v.iter().map(|v| v * v).sum::<f64>().sqrt();
                let basis = harmonics(v[0] / length, v[1] / length, v[2] / length);
                let count = (degree + 1) * (degree + 1);
                std::array::from_fn(|c| {
                    let sum: f64 = (0..count).map(|k| basis[k] * colours[3 * (count * i + k) + c]).sum();
                    (sum + 0.5).max(0.0)
                })
            }
        };
        splats.push(Splat {
            m: [
                fx * p[0] / p[2] + cx + shift[2 * i],
                fy * p[1] / p[2] + cy + shift[2 * i + 1],
            ],
            conic: [(c0 + eps) / det, -b0 / det, (a0 + eps) / det],
            opacity,
            z: p[2],
            rgb,
            index: i,
        });
    }
    splats.sort_by(|a, b| a.z.total_cmp(&b.z));
    let mut total = 0.0;
    for pixel in 0..camera.pixels() {
        let (px, py) = (
            (pixel % camera.width as usize) as f64 + 0.5,
            (pixel / camera.width as usize) as f64 + 0.5,
        );
        let mut through = 1.0;
        let mut sums = vec![0.0; 5 + layout.extra];
        for s in &splats {
            let (dx, dy) = (s.m[0] - px, s.m[1] - py);
            let sigma = 0.5 * (s.conic[0] * dx * dx + s.conic[2] * dy * dy) + s.conic[1] * dx * dy;
            let alpha = (s.opacity * (-sigma).exp()).min(f64::from(config.alpha_max));
            if alpha < 1.0 / 255.0 {
                continue;
            }
            if through * (1.0 - alpha) <= 1e-4 {
                break;
            }
            let weight = alpha * through;
            through *= 1.0 - alpha;
            sums[0] += weight;
            for c in 0..3 {
                sums[1 + c] += weight * s.rgb[c];
            }
            sums[4] += weight * s.z;
            for c in 0..layout.extra {
                sums[5 + c] += weight * extra[layout.extra * s.index + c];
            }
        }
        let floor = sums[0].max(1e-10);
        let [rgb, alpha, depth, expected, accumulated, normalised] = &weights.0;
        for c in 0..3 {
            total += f64::from(rgb[3 * pixel + c]) * (sums[1 + c] + through * background[c]);
        }
        total += f64::from(alpha[pixel]) * sums[0];
        total += f64::from(depth[pixel]) * sums[4] + f64::from(expected[pixel]) * sums[4] / floor;
        for c in 0..layout.extra {
            let at = layout.extra * pixel + c;
            total += f64::from(accumulated[at]) * sums[5 + c] + f64::from(normalised[at]) * sums[5 + c] / floor;
        }
    }
    total
}

/// The formulas of `docs/spec/rasteriser.md` section 8 in f64.
fn harmonics(x: f64, y: f64, z: f64) -> [f64; 16] {
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        0.28209479177387814,
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2.0 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3.0 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4.0 * zz - xx - yy),
        0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.4570457994644658 * x * (4.0 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3.0 * yy),
    ]
}

fn check(seed: u64, degree: Option<usize>, extra: usize, mode: Mode) {
    let n = 12;
    let mut scene: Gaussians = random::scene(n, seed, degree, extra);
    // Away from the alpha ceiling and from subpixel sizes, so that no decision sits near a step.
    scene.opacities.iter_mut().for_each(|o| *o = 0.15 + 0.7 * *o);
    scene.scales.iter_mut().for_each(|s| *s = s.clamp(0.03, 0.5));
    let camera = random::camera(26, 19);
    let camera = RasterCamera {
        rotation: camera.rotation.map(|v| f64::from(v as f32)),
        translation: camera.translation.map(|v| f64::from(v as f32)),
        ..camera
    };
    let config = RasterConfig {
        mode,
        background: [0.3, 0.1, 0.7],
        min_compensation: 0.0,
        ..RasterConfig::default()
    };
    let pixels = camera.pixels();
    let weights =
        Weights([3, 1, 1, 1, extra, extra].map(|channels| room::normals(channels * pixels, seed + channels as u64)));
    let [
        rgb,
        alpha,
        depth_accumulated,
        depth_expected,
        extra_accumulated,
        normalised,
    ] = &weights.0;
    let gradient = RenderGradient {
        rgb,
        alpha,
        depth_accumulated,
        depth_expected,
        extra_accumulated,
        extra: normalised,
    };
    let (image, tape) = render_with_tape(&scene, &camera, &config).unwrap();
    assert!(image.counts.visible >= 6, "too little to see");
    let ours = backward_with_screen(&scene, &config, &tape, &gradient).unwrap();
    let mut without = backward(&scene, &config, &tape, &gradient).unwrap();
    assert!(without.screen.is_empty(), "nobody asked");
    without.screen.clone_from(&ours.screen);
    assert_eq!(without, ours, "the other gradients are the same bits");

    let layout = Layout { n, degree, extra };
    let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
    let inputs = [
        wide(&scene.means),
        wide(&scene.quats),
        wide(&scene.scales),
        wide(&scene.opacities),
        wide(match &scene.colour {
            Colour::Rgb(values)
            | Colour::Sh {
                coefficients: values, ..
            } => values,
        }),
        wide(&scene.extra),
        camera.rotation.to_vec(),
        camera.translation.to_vec(),
        config.background.map(f64::from).to_vec(),
        vec![0.0; 2 * n],
    ];
    let analytic = [
        wide(&ours.means),
        wide(&ours.quats),
        wide(&ours.scales),
        wide(&ours.opacities),
        wide(&ours.colour),
        wide(&ours.extra),
        ours.camera_rotation.to_vec(),
        ours.camera_translation.to_vec(),
        ours.background.to_vec(),
        wide(&ours.screen),
    ];
    let mut all: Vec<f64> = inputs.concat();
    let mut at = 0;
    for ((name, length), analytic) in layout.parts().into_iter().zip(analytic) {
        let (mut difference, mut norm) = (0.0, 0.0);
        for value in analytic {
            let centre = all[at];
            let step = 1e-6;
            let mut side = |offset: f64| {
                all[at] = centre + offset;
                loss(&layout, &all, &camera, &config, &weights)
            };
            let numeric = (side(step) - side(-step)) / (2.0 * step);
            all[at] = centre;
            difference += (value - numeric).powi(2);
            norm += numeric * numeric;
            at += 1;
        }
        if length == 0 {
            continue;
        }
        let relative = (difference / norm.max(1e-12)).sqrt();
        println!("seed {seed} {name}: {relative:e} of {:e}", norm.sqrt());
        assert!(norm > 0.0 && relative < 5e-5, "seed {seed} {name}: {relative}");
    }
}

#[test]
fn plain_colours_and_many_channels() {
    check(21, None, 6, Mode::Classic);
}

#[test]
fn harmonics_of_degree_three() {
    check(22, Some(3), 3, Mode::Classic);
}

#[test]
fn antialiased() {
    check(23, Some(1), 0, Mode::Antialiased);
}
