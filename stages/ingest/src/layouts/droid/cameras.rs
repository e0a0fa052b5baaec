//! The cameras of an episode: videos, intrinsics and mounts put together, with what is to be said about each.

use std::path::Path;

use rogs_geometry::{Base, Camera, Link, Pose};
use rogs_schemas::Intrinsics;
use rogs_schemas::records::clip::CameraRole;
use rogs_worker::StageResult;

use super::eyes::{self, Eye, Eyes};
use super::lenses;
use super::metadata::{CAMERAS, Metadata};
use super::mounts::{self, Named};
use super::published::Calibrations;
use super::trajectory::{CameraLog, Trajectory};
use super::tree::{RELEASE, VIDEOS};
use crate::calibration::Calibration;
use crate::fault::wrong;
use crate::images::{FrameOrder, FrameSource};
use crate::layouts::calibration_names;
use crate::params::DroidParams;
use crate::source::{SourceCamera, SourceMount};

/// A camera of the episode that can be used.
pub(super) struct Found {
    pub(super) id: &'static str,
    pub(super) serial: String,
    pub(super) eyes: Eyes,
    pub(super) log: CameraLog,
}

/// The cameras that have videos; the others are told.
pub(super) fn find_cameras(
    root: &Path,
    serials: &[Option<String>; 3],
    trajectory: &Trajectory,
    warnings: &mut Vec<String>,
) -> StageResult<Vec<Found>> {
    let mut found = Vec::new();
    for (id, serial) in CAMERAS.into_iter().zip(serials) {
        let Some(serial) = serial else {
            warnings.push(format!("camera `{id}` is left out: the metadata has no serial of it"));
            continue;
        };
        match eyes::open(root, serial)? {
            None => {
                let way = if has_svo(root, serial) { SVO } else { RELEASE };
                warnings.push(format!(
                    "camera `{id}` ({serial}) is left out: there is no `{}/{serial}.mp4` and no `{serial}-stereo.mp4`; {way}",
                    VIDEOS
                ));
            }
            Some(eyes) => {
                let log = trajectory.camera(serial)?;
                let serial = serial.clone();
                found.push(Found { id, serial, eyes, log });
            }
        }
    }
    if found.is_empty() {
        let svo = serials.iter().flatten().any(|serial| has_svo(root, serial));
        let (what, way) = if svo {
            ("there is no video of any camera of the episode, only SVO files", SVO)
        } else {
            ("there is no video of any camera of the episode", RELEASE)
        };
        return Err(wrong(&root.join(VIDEOS), what).with_hint(way));
    }
    Ok(found)
}

/// What becomes of SVO files.
const SVO: &str = "SVO files are not read, since only the ZED SDK decodes them: export left and right side by side with its \
                   sample `svo export`, and save that as recordings/MP4/SERIAL-stereo.mp4";

/// Whether a camera has its recording in the maker's own form.
fn has_svo(root: &Path, serial: &str) -> bool {
    ["svo", "svo2"]
        .iter()
        .any(|ending| root.join(format!("recordings/SVO/{serial}.{ending}")).is_file())
}

/// Puts cameras together and keeps what is to be said.
pub(super) struct Builder<'a> {
    pub(super) uuid: &'a str,
    /// The trajectory.
    pub(super) path: &'a Path,
    pub(super) metadata: &'a Metadata,
    pub(super) calibrations: &'a Calibrations,
    pub(super) flanges: &'a [Pose<Base, Link>],
    pub(super) params: &'a DroidParams,
    pub(super) notes: &'a mut Vec<String>,
    pub(super) warnings: &'a mut Vec<String>,
}

impl<'a> Builder<'a> {
    fn named<'b>(&self, camera: &'b Found) -> Named<'b>
    where
        'a: 'b,
    {
        Named {
            id: camera.id,
            serial: &camera.serial,
            uuid: self.uuid,
            path: self.path,
        }
    }

    /// The 6-vector of the metadata, if it was filled in.
    fn six(&self, id: &str) -> StageResult<Option<[f64; 6]>> {
        let (key, values) = match id {
            "wrist" => ("wrist_cam_extrinsics", &self.metadata.wrist_cam_extrinsics),
            "ext1" => ("ext1_cam_extrinsics", &self.metadata.ext1_cam_extrinsics),
            _ => ("ext2_cam_extrinsics", &self.metadata.ext2_cam_extrinsics),
        };
        let Some(values) = values else { return Ok(None) };
        let six: [f64; 6] = values.clone().try_into().map_err(|values: Vec<f64>| {
            wrong(
                self.path,
                format!("`{key}` of the metadata has {} numbers, expected 6", values.len()),
            )
        })?;
        Ok(Some(six).filter(|six| six.iter().any(|&value| value != 0.0)))
    }

    pub(super) fn check_serials(&mut self, found: &[Found]) -> StageResult<()> {
        let mut externals = Vec::new();
        for camera in found.iter().filter(|camera| camera.id != "wrist") {
            externals.push((self.named(camera), self.six(camera.id)?, &camera.log));
        }
        let said = mounts::check_serials(self.path, &externals)?;
        self.warnings.extend(said);
        Ok(())
    }

    /// Left and right eye of a camera; `None` when its pose is unknown.
    pub(super) fn camera(
        &mut self,
        camera: Found,
        frames: Vec<u64>,
    ) -> StageResult<Option<(SourceCamera, Option<SourceCamera>)>> {
        let Found { id, serial, .. } = &camera;
        let own = match &self.calibrations.own {
            None => None,
            Some(own) => {
                let mut names = calibration_names(id, serial);
                names.push(format!("{serial}_left"));
                let names: Vec<&str> = names.iter().map(String::as_str).collect();
                own.camera(&names, camera.eyes.size)?
            }
        };
        let (own_lens, own_mount) = own.map_or((None, None), |own| (Some(own.intrinsics), own.mount));
        let asked = lenses::Asked {
            id,
            serial,
            uuid: self.uuid,
            wrist: *id == "wrist",
            size: camera.eyes.size,
            path: self.path,
        };
        let published = self.calibrations.published.as_ref();
        let file = self
            .calibrations
            .own
            .as_ref()
            .map(Calibration::note)
            .unwrap_or_default();
        let (intrinsics, lens_origin) = match own_lens {
            Some(intrinsics) => (intrinsics, file.clone()),
            None => {
                let lensed = lenses::intrinsics(&asked, &camera.log, published)?;
                self.warnings.extend(lensed.warnings);
                (lensed.intrinsics, lensed.origin)
            }
        };
        let mounted = match own_mount {
            Some(mount) => Some((mount, file)),
            None => self.mount(&camera, &intrinsics)?,
        };
        let Some((mount, origin)) = mounted else {
            return Ok(None);
        };
        self.notes
            .push(format!("{id} {serial}: intrinsics {lens_origin}, pose {origin}"));
        let times = camera.log.capture_ms.as_ref();
        let times_ms: Option<Vec<f64>> =
            times.and_then(|times| frames.iter().map(|&frame| times.get(frame as usize).copied()).collect());
        let right = match &camera.eyes.right {
            Some(eye) if self.params.right_eyes => {
                let (measured, odd) = mounts::measured_baseline(self.named(&camera), &camera.log)?;
                let (metres, guess) = lenses::baseline(&asked, measured, published)?;
                self.warnings.extend(odd.into_iter().chain(guess));
                let mount = beside(&mount, metres).map_err(|error| wrong(self.path, error))?;
                let mut right = source(
                    &format!("{id}_right"),
                    camera.eyes.size,
                    intrinsics,
                    mount,
                    eye,
                    &frames,
                );
                right.role = CameraRole::Evaluation;
                right.partner = Some((*id).to_owned());
                right.times_ms = times_ms.clone();
                Some(right)
            }
            _ => None,
        };
        let mut left = source(id, camera.eyes.size, intrinsics, mount, &camera.eyes.left, &frames);
        left.times_ms = times_ms;
        left.serial = Some(serial.clone());
        Ok(Some((left, right)))
    }

    /// The mount of a camera's left eye with its origin.
    fn mount(&mut self, camera: &Found, lens: &Intrinsics) -> StageResult<Option<(SourceMount, String)>> {
        let six = self.six(camera.id)?;
        let published = self.calibrations.published.as_ref();
        let named = self.named(camera);
        let Named { id, serial, .. } = named;
        if id == "wrist" {
            let hand_eye = match self.flanges.first() {
                Some(flange) => mounts::hand_eye(named, self.metadata, six, &camera.log, flange, published)?,
                None => None,
            };
            let Some(hand_eye) = hand_eye else {
                self.warnings.push(format!(
                    "camera `{id}` ({serial}) is left out: neither metadata nor HDF5 has its pose; give the published \
                     `gripper2wrist_transforms.json` in a calibration folder (docs/droid.md)"
                ));
                return Ok(None);
            };
            self.warnings.extend(hand_eye.warnings);
            let mount = SourceMount::HandEye {
                link: self.params.flange_link.clone(),
                link_from_camera: hand_eye.pose.to_rigid(),
            };
            return Ok(Some((mount, hand_eye.origin)));
        }
        let Some(external) = mounts::external(named, six, &camera.log, (published, &self.params.quality))? else {
            if let Some(published) = published {
                self.warnings.extend(published.only_between_cameras(self.uuid, serial)?);
            }
            self.warnings.push(format!(
                "camera `{id}` ({serial}) is left out: neither metadata nor HDF5 has its pose; give the published \
                 `cam2base_extrinsics.json` or `cam2base_extrinsic_superset.json` in a calibration folder (docs/droid.md)"
            ));
            return Ok(None);
        };
        let unseen = mounts::check_sight(named, &external.pose, lens, camera.eyes.size, self.flanges)?;
        self.warnings.extend(external.warnings.into_iter().chain(unseen));
        Ok(Some((SourceMount::Fixed(external.pose.to_rigid()), external.origin)))
    }
}

/// The mount of the right eye: a baseline to the right of the left one.
fn beside(mount: &SourceMount, metres: f64) -> Result<SourceMount, rogs_geometry::Error> {
    let step: Pose<Camera, Camera> = Pose::from_xyz_euler([metres, 0.0, 0.0], [0.0; 3]);
    Ok(match mount {
        SourceMount::Fixed(pose) => SourceMount::Fixed((Pose::<Base, Camera>::from_rigid(pose)? * step).to_rigid()),
        SourceMount::HandEye { link, link_from_camera } => SourceMount::HandEye {
            link: link.clone(),
            link_from_camera: (Pose::<Link, Camera>::from_rigid(link_from_camera)? * step).to_rigid(),
        },
        SourceMount::Trajectory(poses) => {
            let moved = poses
                .iter()
                .map(|pose| Ok((Pose::<Base, Camera>::from_rigid(pose)? * step).to_rigid()));
            SourceMount::Trajectory(moved.collect::<Result<_, rogs_geometry::Error>>()?)
        }
    })
}

/// A source camera from one eye.
fn source(
    id: &str,
    (width, height): (u32, u32),
    intrinsics: Intrinsics,
    mount: SourceMount,
    eye: &Eye,
    frames: &[u64],
) -> SourceCamera {
    SourceCamera {
        id: id.to_owned(),
        serial: None,
        role: CameraRole::Source,
        partner: None,
        width,
        height,
        intrinsics,
        pixel_shift: 0.5,
        mount,
        images: Some(FrameSource::Video {
            path: eye.path.clone(),
            info: eye.info.clone(),
            order: FrameOrder::Listed(frames.to_vec()),
            part: eye.part,
        }),
        times_ms: None,
        depth: None,
    }
}
