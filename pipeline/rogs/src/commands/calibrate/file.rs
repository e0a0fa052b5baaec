//! The calibration file (`docs/calibration-format.md`).

use rogs_agreement::audit::Mount;
use rogs_geometry::{Base, Camera, Link, Pinhole, Pose};
use rogs_schemas::records::clip::{CameraMount, CameraRole, Clip, ClipCamera};
use serde_json::{Map, Value, json};

use super::Args;
use super::camera::Calibrated;
use super::clips::{Clips, rows};

/// The text of the file: all cameras of the clips, those that were not calibrated as they were given.
pub(super) fn calibration(clips: &Clips, cameras: &[Calibrated], args: &Args) -> String {
    let clip = &clips.clips[0];
    let mut entries = Map::new();
    for given in &clip.cameras {
        let calibrated = cameras.iter().find(|camera| camera.name == given.id);
        let entry = match calibrated.map(|camera| (&camera.refined, camera)) {
            Some((Ok(refined), camera)) => Some(entry(&refined.lens, &refined.mount, camera, clip)),
            // Nothing is known of what was searched in vain.
            _ if args.new => None,
            _ => kept(given, clip, cameras),
        };
        entries.extend(entry.map(|entry| (given.id.clone(), entry)));
    }
    let names: Vec<&str> = cameras
        .iter()
        .filter(|camera| camera.refined.is_ok())
        .map(|camera| camera.name.as_str())
        .collect();
    let status = format!(
        "{} calibrated by the robot in the images (rogs calibrate, {} of {}); start: {}",
        names.join(", "),
        env!("CARGO_PKG_VERSION"),
        clips.episodes.join(", "),
        clips.start
    );
    let file = json!({
        "status": status,
        "image_size": [clip.width, clip.height],
        "pixel_centres": "half",
        "cameras": entries,
    });
    format!("{file:#}\n")
}

fn intrinsic(lens: &Pinhole) -> Value {
    let i = lens.intrinsics;
    json!([[i.fx, 0, i.cx], [0, i.fy, i.cy], [0, 0, 1]])
}

fn entry(lens: &Pinhole, mount: &Mount, camera: &Calibrated, clip: &Clip) -> Value {
    let mut entry = json!({"intrinsic": intrinsic(lens)});
    match mount {
        Mount::Fixed(pose) => entry["camera_to_base"] = rows(pose),
        Mount::Hand { link_from_camera, .. } => {
            entry["link"] = link_name(clip, &camera.name).into();
            entry["camera_to_link"] = rows(link_from_camera);
        }
        Mount::Path(_) => {}
    }
    if let Ok(refined) = &camera.refined {
        let [a, b, c, x, y, z, ..] = refined.sigma;
        entry["sigma"] = json!({
            "shift_mm": [1000.0 * x, 1000.0 * y, 1000.0 * z],
            "turn_degrees": [a.to_degrees(), b.to_degrees(), c.to_degrees()],
        });
    }
    entry
}

fn link_name<'a>(clip: &'a Clip, name: &str) -> &'a str {
    let camera = clip.cameras.iter().find(|camera| camera.id == name);
    match camera.map(|camera| &camera.mount) {
        Some(CameraMount::HandEye { link, .. }) => link,
        _ => "",
    }
}

/// A camera as it was given; the right eye of one that has moved goes with it. A pose of every frame has no place in the
/// file.
fn kept(given: &ClipCamera, clip: &Clip, cameras: &[Calibrated]) -> Option<Value> {
    let left = given.partner.filter(|_| given.role == CameraRole::Evaluation);
    let left = left.and_then(|index| clip.cameras.get(index.at()));
    let left = left.and_then(|left| cameras.iter().find(|camera| camera.name == left.id));
    let left = left.and_then(|camera| Some((camera, camera.refined.as_ref().ok()?)));
    let mut entry = json!({"intrinsic": intrinsic(&Pinhole::of_clip(clip, given))});
    match &given.mount {
        CameraMount::Fixed { base_from_camera } => {
            let own: Pose<Base, Camera> = Pose::from_rigid(base_from_camera).ok()?;
            entry["camera_to_base"] = match left.map(|(camera, refined)| (&camera.given, &refined.mount)) {
                Some((Mount::Fixed(before), Mount::Fixed(after))) => rows(&(*after * (before.inverse() * own))),
                _ => rows(&own),
            };
        }
        CameraMount::HandEye { link, link_from_camera } => {
            let own: Pose<Link, Camera> = Pose::from_rigid(link_from_camera).ok()?;
            entry["link"] = link.as_str().into();
            entry["camera_to_link"] = match left.map(|(camera, refined)| (&camera.given, &refined.mount)) {
                Some((
                    Mount::Hand {
                        link_from_camera: before,
                        ..
                    },
                    Mount::Hand {
                        link_from_camera: after,
                        ..
                    },
                )) => rows(&(*after * (before.inverse() * own))),
                _ => rows(&own),
            };
        }
        CameraMount::Trajectory { .. } => return None,
    }
    Some(entry)
}
