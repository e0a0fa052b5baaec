//! The network of a field, which answers times that are not stored.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail, ensure};
use rogs_geometry::{Base, LinkPoses, Pose, Recon};
use rogs_lift::{FieldQuery, LiftParams, Model, MotionOptions, RobotAtTime, builtin_of, load_builtin, load_model};
use rogs_r4c::read_record;
use rogs_schemas::FileInfo;
use rogs_schemas::records::clip::{Clip, SourceView};
use rogs_schemas::records::conditioning::Conditioning;
use rogs_schemas::records::field::{Field, TimeSlice};
use rogs_schemas::records::robot::RobotMaps;
use rogs_stage1::held::HeldPath;

/// Files of the field's clip and its weights.
#[derive(Debug, clap::Args)]
pub(crate) struct BesideArgs {
    /// Weights that the field was lifted with, for times that are not stored; not needed for the
    /// built-in ones and for seeded ones.
    #[arg(long, value_name = "FILE")]
    pub(crate) weights: Option<PathBuf>,
    /// The clip, for its cameras and references. Default: `clip.r4c` beside the field.
    #[arg(long, value_name = "FILE")]
    clip: Option<PathBuf>,
    /// Robot maps of the clip. Default: `robot.r4c` beside the field.
    #[arg(long, value_name = "FILE")]
    robot: Option<PathBuf>,
    /// Conditioning of the clip, for times that are not stored. Default: `conditioning.r4c` beside the field.
    #[arg(long, value_name = "FILE")]
    conditioning: Option<PathBuf>,
}

impl BesideArgs {
    pub(crate) fn clip(&self, field: &Path) -> PathBuf {
        self.clip.clone().unwrap_or_else(|| field.with_file_name("clip.r4c"))
    }

    pub(crate) fn robot(&self, field: &Path) -> PathBuf {
        self.robot.clone().unwrap_or_else(|| field.with_file_name("robot.r4c"))
    }

    fn conditioning(&self, field: &Path) -> PathBuf {
        let beside = || field.with_file_name("conditioning.r4c");
        self.conditioning.clone().unwrap_or_else(beside)
    }
}

/// The network and what it is told of the robot.
pub(crate) struct Network {
    model: Model,
    options: MotionOptions,
    robot: Option<Robot>,
}

/// What is known of the robot.
struct Robot {
    maps: RobotMaps,
    conditioning: Conditioning,
    /// The path of what the gripper holds, where the weights ask for it.
    held: Option<HeldPath>,
}

impl Network {
    /// Loads the network that a field was lifted with.
    pub(crate) fn load(path: &Path, field: &Field, info: &FileInfo, beside: &BesideArgs) -> anyhow::Result<Self> {
        if field.query_state.is_empty() {
            let stored: Vec<String> = field.slices.iter().map(|slice| slice.time.to_string()).collect();
            bail!(
                "the field stores no values at this time and was written without its query state; lift it again with \
                 `query_state = \"keep\"`, or take one of the stored times: {}",
                stored.join(", ")
            );
        }
        let params: LiftParams = serde_json::from_str(&info.provenance.material.params)
            .context("the field was written by another version of `lift`; lift it again")?;
        let builtin = builtin_of(&field.weights.hash).filter(|_| beside.weights.is_none());
        if field.weights.trained && beside.weights.is_none() && builtin.is_none() {
            bail!(
                "the field was lifted with `{}`; give that file with `--weights`",
                field.weights.description
            );
        }
        let model = match builtin {
            Some(file) => load_builtin(&params, file)?,
            None => load_model(&params, beside.weights.as_deref())?,
        };
        ensure!(
            model.info.hash == field.weights.hash,
            "these are not the weights that the field was lifted with (`{}`)",
            field.weights.description
        );
        let robot = match params.fk_conditioning {
            false => None,
            true => {
                let (maps, _) = read_record::<RobotMaps>(&beside.robot(path))?;
                let (conditioning, _) = read_record::<Conditioning>(&beside.conditioning(path))?;
                for id in [&maps.clip_id, &conditioning.clip_id] {
                    ensure!(
                        *id == field.clip_id,
                        "robot maps or conditioning belong to clip `{id}`, the field to `{}`",
                        field.clip_id
                    );
                }
                let held = match model.network.held_gate()? {
                    Some(_) => {
                        let hint = "these weights move what the gripper holds, and its states are in the clip: give it with \
                                    `--clip`";
                        let (clip, _) = read_record::<Clip>(&beside.clip(path)).context(hint)?;
                        ensure!(
                            clip.clip_id == field.clip_id,
                            "the clip is `{}`, the field is of `{}`",
                            clip.clip_id,
                            field.clip_id
                        );
                        HeldPath::of_clip(&maps, &clip.robot.gripper)?
                    }
                    None => None,
                };
                Some(Robot {
                    maps,
                    conditioning,
                    held,
                })
            }
        };
        let options = MotionOptions {
            gates: params.gates(),
            robot_motion: params.robot_motion,
        };
        Ok(Self { model, options, robot })
    }

    /// Prepares a field for queries.
    pub(crate) fn query<'a>(&'a self, field: &'a Field) -> anyhow::Result<FieldQuery<'a>> {
        Ok(FieldQuery::new(field, &self.model.network, self.options)?)
    }

    /// The field at a time.
    pub(crate) fn at(&self, query: &FieldQuery<'_>, field: &Field, time: f64) -> anyhow::Result<TimeSlice> {
        let robot = match &self.robot {
            Some(robot) => robot.at(field, time)?,
            None => Vec::new(),
        };
        Ok(query.at(time, &robot)?)
    }
}

/// Puts a slice where it belongs among those that a field has.
pub(crate) fn insert(field: &mut Field, slice: TimeSlice) {
    let place = field.slices.partition_point(|stored| stored.time < slice.time);
    field.slices.insert(place, slice);
}

impl Robot {
    /// How it moves from each source view to a time between frames.
    fn at(&self, field: &Field, time: f64) -> anyhow::Result<Vec<Option<RobotAtTime>>> {
        let Self {
            maps,
            conditioning,
            held,
        } = self;
        let position = time * f64::from(field.frame_count.saturating_sub(1));
        let query = LinkPoses::between_frames(maps, position)?;
        let recon_from_base: Pose<Recon, Base> = Pose::from_rigid(&maps.recon_from_base)?;
        let points = 3 * (field.height * field.width) as usize;
        let view = |(view, position_m): (&SourceView, &[f32])| {
            let stored = conditioning.views.iter().position(|other| other == view);
            let stored = stored.context("the conditioning lacks a source view of the field")?;
            let motions = query.motion_from(&LinkPoses::at_frame(maps, view.frame)?);
            let robot = RobotAtTime::new(conditioning, stored, 0, &motions, Some(position_m));
            Ok(Some(match held {
                Some(path) => robot.with_held(path, view.frame, position, &recon_from_base),
                None => robot,
            }))
        };
        let views = field.views.iter().zip(field.position_m.chunks_exact(points));
        views.map(view).collect()
    }
}
