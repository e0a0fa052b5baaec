//! What may be wrong with a camera, one supposition after the other.

use rogs_geometry::Pinhole;
use rogs_schemas::Intrinsics;

use super::footage::{Footage, Mount};
use super::mistake::Mistake;
use super::trial::{Picture, Supposed};

/// Stereo baselines of the cameras that robots mostly carry, metres: ZED Mini and ZED 2.
const BASELINES_M: [f64; 2] = [0.063, 0.12];

/// What may be wrong with a camera of a clip, and the camera without it.
pub(super) fn suppositions_of(
    footage: &Footage<'_>,
    given: &[Supposed],
    index: usize,
    readings: &[Mistake],
) -> Vec<(usize, Mistake, Supposed)> {
    let own = &given[index];
    let mut out: Vec<(Mistake, Supposed)> = Vec::new();
    let with_mount = |mount: Mount| Supposed { mount, ..own.clone() };
    let inverted = match &own.mount {
        Mount::Fixed(pose) => Mount::Fixed(pose.inverse().relabelled()),
        Mount::Path(poses) => Mount::Path(poses.iter().map(|pose| pose.inverse().relabelled()).collect()),
        Mount::Hand { link, link_from_camera } => Mount::Hand {
            link: *link,
            link_from_camera: link_from_camera.inverse().relabelled(),
        },
    };
    out.push((Mistake::InvertedPose, with_mount(inverted)));
    let on_hand = matches!(own.mount, Mount::Hand { .. });
    for (other, camera) in given.iter().enumerate() {
        if other != index && !on_hand && !matches!(camera.mount, Mount::Hand { .. }) {
            let camera_name = footage.cameras[other].name.to_owned();
            out.push((
                Mistake::SwappedWith { camera: camera_name },
                with_mount(camera.mount.clone()),
            ));
        }
    }
    for right_m in BASELINES_M.into_iter().flat_map(|baseline| [baseline, -baseline]) {
        out.push((Mistake::OtherEye { right_m }, with_mount(beside(&own.mount, right_m))));
    }
    for (mistake, intrinsics) in other_intrinsics(&own.lens) {
        let lens = Pinhole { intrinsics, ..own.lens };
        out.push((mistake, Supposed { lens, ..own.clone() }));
    }
    let pictures = [
        (Mistake::Mirrored, Picture::Mirrored),
        (Mistake::UpsideDown, Picture::UpsideDown),
    ];
    let distorted = [-0.3, -0.2, -0.1, 0.1, 0.2, 0.3].map(|k1| (Mistake::Distortion { k1 }, Picture::Distorted(k1)));
    for (mistake, picture) in pictures.into_iter().chain(distorted) {
        out.push((mistake, Supposed { picture, ..own.clone() }));
    }
    if !on_hand {
        let of_readings = readings.iter().enumerate().map(|(reading, mistake)| {
            let states = reading + 1;
            (mistake.clone(), Supposed { states, ..own.clone() })
        });
        out.extend(of_readings);
    }
    out.into_iter()
        .map(|(mistake, supposed)| (index, mistake, supposed))
        .collect()
}

fn beside(mount: &Mount, right_m: f64) -> Mount {
    mount.moved(rogs_geometry::Pose::from_translation(glam::DVec3::X * right_m))
}

fn other_intrinsics(lens: &Pinhole) -> Vec<(Mistake, Intrinsics)> {
    let Intrinsics { fx, fy, cx, cy } = lens.intrinsics;
    let (width, height) = (f64::from(lens.width), f64::from(lens.height));
    let mut out = vec![(
        Mistake::TransposedIntrinsics,
        Intrinsics {
            fx: fy,
            fy: fx,
            cx: cy,
            cy: cx,
        },
    )];
    // The principal point lies near the middle of the images that the intrinsics belong to.
    let (sx, sy) = (0.5 * width / cx, 0.5 * height / cy);
    let off = |factor: f64| !(0.85..=1.18).contains(&factor);
    if sx.is_finite() && sy.is_finite() && sx > 0.0 && sy > 0.0 && (off(sx) || off(sy)) {
        let scaled = Intrinsics {
            fx: fx * sx,
            fy: fy * sy,
            cx: cx * sx,
            cy: cy * sy,
        };
        out.push((Mistake::UnscaledIntrinsics { width: width / sx }, scaled));
    }
    for factor in [0.5, 0.7, 0.85, 1.18, 1.42, 2.0] {
        let scaled = Intrinsics {
            fx: fx * factor,
            fy: fy * factor,
            cx,
            cy,
        };
        out.push((Mistake::FocalLength { factor }, scaled));
    }
    out
}
