//! The shells of the links: lofts, lathes and chamfered boxes in each link's own frame.
//!
//! Materials: 0 light shell, 1 dark seams and caps, 2 metal, 3 gripper black, 4 pads, 5 accent.

use glam::DVec3;
use rogs_geometry::Pose;

use super::{KNUCKLE_LEAN, KNUCKLE_LENGTH, PAD_OFFSET};
use crate::math::{rot_axis, rot_x, rot_y};
use crate::mesh::{Section, TriMesh};

const SHELL: u8 = 0;
const SEAM: u8 = 1;
const METAL: u8 = 2;
const BLACK: u8 = 3;
const PAD: u8 = 4;
const ACCENT: u8 = 5;

const AROUND: usize = 20;
const HALF_TURN: f64 = std::f64::consts::FRAC_PI_2;

/// The mesh of the link of this index in [`super::Robot`].
pub(super) fn link_mesh(link: usize) -> TriMesh {
    match link {
        0 => base(),
        1 => shoulder(),
        2 => upper_arm(),
        3 => elbow(),
        4 => lower_elbow(),
        5 => forearm(),
        6 => wrist(),
        7 => hand(),
        8 => flange(),
        9 => gripper_base(),
        10 => knuckle(1.0),
        11 => finger(1.0),
        12 => bar(1.0),
        13 => knuckle(-1.0),
        14 => finger(-1.0),
        15 => bar(-1.0),
        _ => camera_body(),
    }
}

fn union(parts: impl IntoIterator<Item = TriMesh>) -> TriMesh {
    let mut whole = TriMesh::default();
    for part in parts {
        whole.join(part);
    }
    whole
}

fn loft(sections: &[Section], material: u8) -> TriMesh {
    TriMesh::loft(sections, AROUND).of(material)
}

/// A drum with rounded rims and a dark inset cap on both ends, axis z.
fn joint_drum(radius: f64, half: f64, material: u8) -> TriMesh {
    let profile = [
        [0.55 * radius, -half],
        [0.86 * radius, -half + 0.004],
        [radius, -half + 0.02],
        [radius, half - 0.02],
        [0.86 * radius, half - 0.004],
        [0.55 * radius, half],
    ];
    let drum = TriMesh::lathe(&profile, AROUND).of(material);
    let cap = TriMesh::cylinder(0.5 * radius, half + 0.002, AROUND).of(SEAM);
    union([drum, cap])
}

fn seam_ring(radius: f64, z: f64) -> TriMesh {
    TriMesh::cylinder(radius, 0.006, AROUND).at(0.0, 0.0, z).of(SEAM)
}

fn base() -> TriMesh {
    let foot = loft(
        &[
            Section::oval(0.0, [-0.035, 0.0], [0.118, 0.098], 4.0),
            Section::oval(0.012, [-0.035, 0.0], [0.122, 0.102], 4.0),
            Section::oval(0.05, [-0.030, 0.0], [0.112, 0.095], 3.4),
            Section::oval(0.095, [-0.008, 0.0], [0.086, 0.083], 2.4),
            Section::circle(0.13, 0.073),
            Section::circle(0.142, 0.070),
        ],
        SHELL,
    );
    let socket = TriMesh::chamfered([0.03, 0.05, 0.035], 0.008)
        .at(-0.145, 0.0, 0.04)
        .of(SEAM);
    let light = TriMesh::chamfered([0.02, 0.035, 0.004], 0.002)
        .at(-0.105, 0.0, 0.083)
        .of(ACCENT);
    union([foot, socket, light, seam_ring(0.066, 0.143)])
}

fn shoulder() -> TriMesh {
    let column = loft(
        &[
            Section::circle(-0.185, 0.066),
            Section::circle(-0.178, 0.070),
            Section::circle(-0.105, 0.067),
            Section::oval(-0.055, [0.0, 0.0], [0.063, 0.068], 2.2),
            Section::oval(0.0, [0.0, 0.0], [0.050, 0.060], 2.6),
        ],
        SHELL,
    );
    let drum = joint_drum(0.064, 0.062, SHELL).placed(Pose::new(rot_x(HALF_TURN), DVec3::ZERO));
    union([column, drum])
}

fn upper_arm() -> TriMesh {
    // Arm along -y of this link; lofts run along their own z.
    let along = Pose::new(rot_x(HALF_TURN), DVec3::ZERO);
    let cheeks = joint_drum(0.058, 0.100, SHELL);
    let arm = loft(
        &[
            Section::oval(0.035, [0.0, 0.0], [0.054, 0.080], 3.0),
            Section::oval(0.075, [0.0, 0.0], [0.062, 0.078], 2.6),
            Section::circle(0.125, 0.066),
            Section::circle(0.176, 0.062),
            Section::circle(0.186, 0.058),
        ],
        SHELL,
    )
    .placed(along);
    union([cheeks, arm])
}

fn elbow() -> TriMesh {
    let sleeve = loft(
        &[
            Section::circle(-0.124, 0.058),
            Section::circle(-0.116, 0.063),
            Section::oval(-0.070, [0.010, 0.0], [0.066, 0.063], 2.2),
            Section::oval(-0.020, [0.045, 0.0], [0.076, 0.063], 2.6),
            Section::oval(0.022, [0.075, 0.0], [0.060, 0.058], 2.4),
        ],
        SHELL,
    );
    let drum = joint_drum(0.061, 0.064, SHELL).placed(Pose::new(rot_x(HALF_TURN), DVec3::new(0.0825, 0.0, 0.0)));
    union([sleeve, drum, seam_ring(0.056, -0.127)])
}

fn lower_elbow() -> TriMesh {
    let cheeks = joint_drum(0.055, 0.100, SHELL);
    let neck = loft(
        &[
            Section::oval(-0.020, [-0.020, 0.0], [0.058, 0.078], 3.0),
            Section::oval(0.030, [-0.050, 0.0], [0.072, 0.074], 2.4),
            Section::oval(0.062, [-0.074, 0.0], [0.064, 0.064], 2.0),
            Section::oval(0.092, [-0.0825, 0.0], [0.060, 0.060], 2.0),
        ],
        SHELL,
    )
    .placed(Pose::new(rot_x(-HALF_TURN), DVec3::ZERO));
    union([cheeks, neck])
}

fn forearm() -> TriMesh {
    let sleeve = loft(
        &[
            Section::circle(-0.288, 0.056),
            Section::circle(-0.280, 0.062),
            Section::oval(-0.215, [0.0, 0.004], [0.063, 0.064], 2.0),
            Section::oval(-0.150, [0.0, 0.026], [0.058, 0.066], 2.2),
            Section::oval(-0.080, [0.0, 0.058], [0.050, 0.044], 2.6),
            Section::oval(-0.010, [0.0, 0.070], [0.048, 0.034], 2.8),
            Section::oval(0.030, [0.0, 0.072], [0.040, 0.028], 2.6),
            Section::oval(0.044, [0.0, 0.072], [0.030, 0.020], 2.4),
        ],
        SHELL,
    );
    let axle = TriMesh::cylinder(0.043, 0.062, AROUND).placed(Pose::new(rot_x(HALF_TURN), DVec3::new(0.0, 0.008, 0.0)));
    union([sleeve, axle.of(SHELL), seam_ring(0.056, -0.291)])
}

fn wrist() -> TriMesh {
    // Joint axis z; the hand's axis stands at x = 0.088.
    let drum = joint_drum(0.051, 0.050, SHELL);
    let bridge = loft(
        &[
            Section::oval(0.020, [0.0, -0.006], [0.046, 0.040], 2.6),
            Section::oval(0.055, [0.0, -0.004], [0.047, 0.042], 2.8),
            Section::oval(0.100, [0.0, 0.002], [0.046, 0.044], 2.8),
            Section::oval(0.126, [0.0, 0.004], [0.036, 0.036], 2.4),
        ],
        SHELL,
    )
    .placed(Pose::new(rot_y(HALF_TURN), DVec3::ZERO));
    let cup = TriMesh::lathe(
        &[[0.038, -0.046], [0.049, -0.036], [0.049, 0.030], [0.044, 0.040]],
        AROUND,
    )
    .placed(Pose::new(rot_x(HALF_TURN), DVec3::new(0.088, 0.0, 0.0)));
    union([drum, bridge, cup.of(SHELL)])
}

fn hand() -> TriMesh {
    let barrel = TriMesh::lathe(
        &[[0.038, 0.038], [0.045, 0.046], [0.045, 0.074], [0.042, 0.080]],
        AROUND,
    )
    .of(SHELL);
    let mount = TriMesh::chamfered([0.036, 0.036, 0.016], 0.008)
        .placed(Pose::new(rot_axis(DVec3::Z, 0.785), DVec3::new(0.030, 0.030, 0.066)))
        .of(SHELL);
    let button = TriMesh::cylinder(0.009, 0.004, 10)
        .placed(Pose::new(rot_x(HALF_TURN), DVec3::new(0.0, -0.046, 0.060)))
        .of(ACCENT);
    union([
        barrel,
        mount,
        button,
        TriMesh::cylinder(0.0315, 0.014, AROUND).at(0.0, 0.0, 0.090).of(METAL),
    ])
}

fn flange() -> TriMesh {
    TriMesh::cylinder(0.0330, 0.006, AROUND).at(0.0, 0.0, -0.002).of(METAL)
}

fn gripper_base() -> TriMesh {
    let adapter = TriMesh::cylinder(0.0375, 0.006, AROUND).at(0.0, 0.0, 0.010).of(METAL);
    let body = loft(
        &[
            Section::oval(0.015, [0.0, 0.0], [0.034, 0.036], 2.2),
            Section::oval(0.024, [0.0, 0.0], [0.0355, 0.040], 2.6),
            Section::oval(0.048, [0.0, 0.0], [0.031, 0.044], 3.2),
            Section::oval(0.068, [0.0, 0.0], [0.024, 0.042], 4.0),
            Section::oval(0.078, [0.0, 0.0], [0.016, 0.028], 4.0),
        ],
        BLACK,
    );
    let plate = |side: f64| {
        TriMesh::chamfered([0.002, 0.020, 0.010], 0.001)
            .at(side * 0.033, 0.0, 0.036)
            .of(METAL)
    };
    union([adapter, body, plate(1.0), plate(-1.0)])
}

/// A bar from the origin along the open lean towards +y (side 1) or -y (side -1).
fn leaning(half: [f64; 3], shift: f64, side: f64) -> TriMesh {
    let turn = rot_axis(DVec3::X, -side * KNUCKLE_LEAN);
    TriMesh::chamfered(half, 0.003).placed(Pose::new(
        turn,
        turn * DVec3::new(0.0, shift * side, 0.5 * KNUCKLE_LENGTH),
    ))
}

fn pin(y: f64, z: f64) -> TriMesh {
    let pose = Pose::new(rot_y(HALF_TURN), DVec3::new(0.0, y, z));
    TriMesh::cylinder(0.0062, 0.0155, 10).placed(pose).of(METAL)
}

fn knuckle(side: f64) -> TriMesh {
    let bar = leaning([0.0115, 0.0062, 0.5 * KNUCKLE_LENGTH + 0.008], 0.003, side).of(BLACK);
    let end_y = side * KNUCKLE_LENGTH * libm::sin(KNUCKLE_LEAN);
    union([bar, pin(0.0, 0.0), pin(end_y, KNUCKLE_LENGTH * libm::cos(KNUCKLE_LEAN))])
}

fn bar(side: f64) -> TriMesh {
    leaning([0.0060, 0.0036, 0.5 * KNUCKLE_LENGTH + 0.004], 0.0, side).of(BLACK)
}

fn finger(side: f64) -> TriMesh {
    // The pivot is at the origin; the pad's face lies PAD_OFFSET towards the middle.
    let inward = -side;
    let shank = TriMesh::chamfered([0.0105, 0.0062, 0.024], 0.003)
        .at(0.0, inward * 0.0008, 0.014)
        .of(BLACK);
    let tip = loft(
        &[
            Section::oval(0.006, [0.0, inward * 0.004], [0.0110, 0.0075], 5.0),
            Section::oval(0.030, [0.0, inward * 0.0055], [0.0110, 0.0055], 5.0),
            Section::oval(0.046, [0.0, inward * 0.0075], [0.0100, 0.0036], 5.0),
        ],
        BLACK,
    );
    let pad = TriMesh::chamfered([0.0112, 0.0021, 0.019], 0.001)
        .at(0.0, inward * (PAD_OFFSET - 0.0021), 0.0285)
        .of(PAD);
    union([shank, tip, pad])
}

fn camera_body() -> TriMesh {
    // Behind the nominal hand-eye pose: everything stays behind the image plane of every rig.
    let camera = crate::cameras::nominal_hand_eye();
    let body = TriMesh::chamfered([0.062, 0.0130, 0.0130], 0.004)
        .at(0.0315, 0.0, -0.032)
        .of(BLACK);
    let lens = |x: f64| TriMesh::cylinder(0.0075, 0.002, 12).at(x, 0.0, -0.0185).of(SEAM);
    let body = union([body, lens(0.0), lens(0.063)]).placed(camera.relabelled());
    let bracket = TriMesh::chamfered([0.018, 0.016, 0.0025], 0.001)
        .at(-0.048, 0.0, -0.0165)
        .of(METAL);
    union([body, bracket])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_link_has_a_solid_shape() {
        for link in 0..17 {
            let mesh = link_mesh(link);
            assert!(mesh.volume() > 1e-6, "link {link}");
            assert!(
                mesh.materials
                    .iter()
                    .all(|&m| (m as usize) < crate::scene::default_robot_colours().len())
            );
            assert_eq!(mesh.positions.len(), mesh.normals.len());
        }
    }

    #[test]
    fn nothing_on_the_flange_reaches_the_wrist_camera() {
        let camera = crate::cameras::nominal_hand_eye();
        let inverse = camera.inverse();
        for vertex in &camera_body().positions {
            assert!(inverse.point(vertex.as_dvec3()).z < -0.013);
        }
    }
}
