//! The pipeline as data: which stages there are, what each reads and who provides it, which files it makes, and which of
//! its parameters the manifest gives elsewhere.
//!
//! This table is all that the orchestrator knows of stages besides what their programs say of themselves
//! ([`Description`](rogs_schemas::protocol::Description)). Adding a stage is one entry here; the compiler then asks for its
//! table in the manifest (`manifest.rs`) and for its program (`rogs/src/stages.rs`).

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use rogs_r4c::source::ROBOT_MODEL;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// What the orchestrator knows of a stage.
#[derive(Debug)]
pub struct StageSpec {
    /// Its inputs. Other inputs that the program describes are provided by no run.
    pub inputs: &'static [Input],
    /// What it makes of a clip: the first output in every run, others where the stages that they read from run too.
    pub outputs: &'static [Output],
    /// Parameters that the manifest gives in other tables than the stage's own, by name.
    pub filled: &'static [(&'static str, Filled)],
    /// For the stage whose parameters may differ between clips: the one that picks a clip out of its folder.
    pub selector: Option<&'static str>,
    /// For the same stage: the parameters that say which frames of an episode are a clip.
    pub interval: Option<Interval>,
    /// What it makes does not depend on the observations: a rollout reads what was made of the recorded clip.
    pub blind: bool,
    /// What a clip costs where nothing has been measured yet.
    pub figures: Figures,
    /// It runs only where the manifest has its table or names it, and what reads it does without it else.
    pub asked: bool,
}

/// What a unit costs, about: a clip of 17 frames of 280x154 pixels of three cameras at five source times, on two cores of a
/// laptop (`docs/performance.md`). Other clips cost as their pixels.
#[derive(Debug, Clone, Copy)]
pub struct Figures {
    /// Seconds.
    pub seconds: f64,
    /// MiB of the output.
    pub output_mib: f64,
    /// MiB that the worker takes.
    pub peak_mib: f64,
}

/// The clip that [`Figures`] are of: pixels of an image, and frames.
pub const FIGURES_OF: [f64; 2] = [280.0 * 154.0, 17.0];

const fn figures(seconds: f64, output_mib: f64, peak_mib: f64) -> Figures {
    Figures {
        seconds,
        output_mib,
        peak_mib,
    }
}

/// The parameters that say which frames of an episode are a clip.
#[derive(Debug)]
pub struct Interval {
    /// The first frame; null where the stage decides.
    pub start: &'static str,
    /// How the stage decides, as a message tells it.
    pub decides: &'static str,
    /// Number of frames.
    pub frames: &'static str,
    /// Episode frames from one to the next.
    pub step: &'static str,
    /// Height and width of its images, pixels.
    pub size: [&'static str; 2],
}

/// An input of a stage.
#[derive(Debug)]
pub struct Input {
    /// Role, as the program describes it.
    pub role: &'static str,
    /// Who provides it.
    pub provider: Provider,
    /// Where it is not always read: when it is.
    pub when: Option<When>,
}

/// When an input is read.
#[derive(Debug)]
pub struct When {
    /// The parameter of the stage that decides.
    pub param: &'static str,
    /// Its value.
    pub is: &'static str,
    /// What is said where nobody provides it then; none where the stage does without.
    pub needed: Option<Needed>,
}

/// What is said of an input that is needed and that nobody provides.
#[derive(Debug)]
pub struct Needed {
    /// What it is, as a message names it.
    pub what: &'static str,
    /// How to provide it.
    pub hint: &'static str,
}

impl When {
    /// Whether these parameters of the stage have it read.
    #[must_use]
    pub fn holds<'a>(&self, param: impl FnOnce(&str) -> Option<&'a Value>) -> bool {
        param(self.param).and_then(Value::as_str) == Some(self.is)
    }
}

/// Who provides an input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Provider {
    /// The clip's episode.
    Episode,
    /// The clip's calibration file, where it has one.
    Calibration,
    /// The file of this role that the episode has in the folder that `pointworld` names, where it has one.
    Reference,
    /// The robot's URDF: `[robot] urdf`.
    Robot,
    /// The clip's file in the folder of `[latents]`, or for a rollout in that of `[rollouts]`.
    Latents,
    /// The clip's folder in that of `[sidecars]`, or for a rollout in that of `[rollouts]`.
    Sidecars,
    /// The clip's video or folder in the folder of `[rollouts]`.
    Rollout,
    /// The clip's folder in one of `[[predictions]]`.
    Predictions,
    /// A file that `[weights]` names.
    Weights(WeightsRole),
    /// The output of another stage.
    Stage(StageId),
    /// Nobody in a run: for a person who runs the stage by hand.
    Hand,
}

/// The files that `[weights]` names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WeightsRole {
    /// `lift`: the Stage-1 checkpoint.
    Lift,
    /// `refine`: the Stage-2 checkpoint.
    Refine,
    /// `lpips`: the network of the metric.
    Lpips,
    /// `adapter`: the latent adapter.
    Adapter,
    /// `movies`: the released network of MoVieS.
    Movies,
    /// `4dgt`: the released network of 4DGT.
    FourDgt,
    /// `dinov2`: the image encoder of 4DGT.
    Dinov2,
}

/// One output of a stage for every clip.
#[derive(Debug)]
pub struct Output {
    /// Name in messages, without a variant.
    pub label: &'static str,
    /// Name of the file in the clip's folder.
    pub file: &'static str,
    /// Name of its rows in the tables, without a variant; empty where it has none.
    pub method: &'static str,
    /// Roles that it does not read.
    pub skips: &'static [&'static str],
    /// A variant that sets this parameter of the stage makes another output instead, where there is one.
    pub unless: Option<&'static str>,
    /// It is made only where this stage, which has to be asked for, runs too.
    pub with: Option<StageId>,
}

/// A baseline that the program runs itself, with units of its own: one stage makes its field, another scores it.
#[derive(Debug)]
pub struct BaselineSpec {
    /// Its name in `[[baselines]]`, and of its rows.
    pub method: &'static str,
    /// What it is, for messages.
    pub words: &'static str,
    /// The stage that makes its field.
    pub lift: StageId,
    /// Parameters of that stage that make it the baseline.
    pub fixed: &'static [(&'static str, Fixed)],
    /// Files that it needs (or `seeded`), each in the place of a role of the stage.
    pub weights: &'static [(WeightsRole, WeightsRole)],
    /// The stage that scores its field.
    pub score: StageId,
    /// What that stage makes of it.
    pub output: Output,
}

/// The value of a parameter that makes a stage a baseline.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fixed {
    /// A word.
    Word(&'static str),
    /// Off.
    Off,
}

/// How the files of outside methods are taken.
#[derive(Debug)]
pub struct Outside {
    /// The stage that takes them, instead of what the run makes.
    pub stage: StageId,
    /// What it makes of them.
    pub output: Output,
    /// The parameter that says how the files are meant.
    pub options: &'static str,
}

/// What the manifest gives in other tables than the stage's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Filled {
    /// `[robot.spec]`.
    RobotSpec,
    /// The name of the output's rows.
    Method,
    /// Whether the clip's observations are recorded or a rollout.
    Observations,
    /// How the files of `[rollouts]` lie.
    Rollout,
    /// True where the manifest has `[rollouts]`.
    HasRollouts,
    /// The network where `[weights]` names no file: the built-in one, or `"seeded"`.
    Weights(WeightsRole),
}

impl Input {
    const fn of(role: &'static str, provider: Provider) -> Self {
        Self {
            role,
            provider,
            when: None,
        }
    }

    const fn when(role: &'static str, provider: Provider, when: When) -> Self {
        Self {
            when: Some(when),
            ..Self::of(role, provider)
        }
    }
}

impl Output {
    const fn new(label: &'static str, file: &'static str) -> Self {
        Self {
            label,
            file,
            method: "",
            skips: &[],
            unless: None,
            with: None,
        }
    }

    /// Whether it reads this role.
    #[must_use]
    pub fn reads(&self, role: &str) -> bool {
        !self.skips.contains(&role)
    }
}

impl StageSpec {
    const PLAIN: Self = Self {
        inputs: &[],
        outputs: &[],
        filled: &[],
        selector: None,
        interval: None,
        blind: false,
        figures: figures(1.0, 1.0, 256.0),
        asked: false,
    };

    /// Stages whose outputs an output of this stage needs.
    pub fn producers<'a>(&'a self, output: &'a Output) -> impl Iterator<Item = StageId> + 'a {
        let read = self.inputs.iter().filter(|input| output.reads(input.role));
        read.filter_map(|input| match input.provider {
            Provider::Stage(stage) if !stage.spec().asked => Some(stage),
            _ => None,
        })
    }
}

impl WeightsRole {
    /// Its name in `[weights]`.
    #[must_use]
    pub fn key(self) -> &'static str {
        match self {
            Self::Lift => "lift",
            Self::Refine => "refine",
            Self::Lpips => "lpips",
            Self::Adapter => "adapter",
            Self::Movies => "movies",
            Self::FourDgt => "4dgt",
            Self::Dinov2 => "dinov2",
        }
    }
}

const CLIP: Input = Input::of("clip", Provider::Stage(StageId::Ingest));
const ROBOT: Input = Input::of("robot", Provider::Stage(StageId::RobotMaps));
const FIELD: Input = Input::of("field", Provider::Stage(StageId::Lift));

/// Makes [`StageId`] and the table behind it: one entry a stage, in the order of the pipeline.
macro_rules! stages {
    ($($(#[$doc:meta])* $id:ident = $name:literal: $spec:expr;)*) => {
        /// A stage; ordered as in the pipeline, so that a stage comes after all those that it reads from.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum StageId {
            $($(#[$doc])* $id,)*
        }

        impl StageId {
            /// Every stage, in the order of the pipeline.
            pub const ALL: &[Self] = &[$(Self::$id),*];

            /// Its name in manifests, files and messages; the program is `rogs-NAME`.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$id => $name,)*
                }
            }

            /// What the orchestrator knows of it.
            #[must_use]
            pub fn spec(self) -> &'static StageSpec {
                match self {
                    $(Self::$id => {
                        static SPEC: StageSpec = $spec;
                        &SPEC
                    })*
                }
            }
        }
    };
}

stages! {
    /// An episode becomes a clip.
    Ingest = "ingest": StageSpec {
        inputs: &[
            Input::of("episode", Provider::Episode),
            Input::of("calibration", Provider::Calibration),
            Input::of("pointworld-cameras", Provider::Reference),
            Input::of("pointworld-depth", Provider::Reference),
            Input::of("pointworld-flows", Provider::Reference),
            Input::when("rollout", Provider::Rollout, When {
                param: "observations",
                is: "rollout",
                needed: Some(Needed {
                    what: "the clips' rollouts",
                    hint: "name their folder: [rollouts] with root = \"FOLDER\" (docs/rollouts.md)",
                }),
            }),
        ],
        filled: &[("observations", Filled::Observations), ("rollout", Filled::Rollout)],
        selector: Some("episode"),
        interval: Some(Interval {
            start: "start_frame",
            decides: "frame 7, where the paper's clips start (the anchor frame of its tracks where an episode has tracks, \
                      0 where the clip would not fit)",
            frames: "frames",
            step: "frame_step",
            size: ["height", "width"],
        }),
        figures: figures(0.3, 20.0, 110.0),
        outputs: &[Output::new("ingest", "clip.r4c")],
        ..StageSpec::PLAIN
    };
    /// Where the robot is in every image.
    RobotMaps = "robot-maps": StageSpec {
        inputs: &[CLIP, Input::of(ROBOT_MODEL, Provider::Robot)],
        filled: &[("robot", Filled::RobotSpec)],
        figures: figures(0.2, 1.4, 125.0),
        outputs: &[Output::new("robot-maps", "robot.r4c")],
        blind: true,
        ..StageSpec::PLAIN
    };
    /// How far forward kinematics moves every pixel of the robot.
    Conditioning = "conditioning": StageSpec {
        inputs: &[CLIP, ROBOT],
        figures: figures(0.1, 5.0, 145.0),
        outputs: &[Output::new("conditioning", "conditioning.r4c")],
        blind: true,
        ..StageSpec::PLAIN
    };
    /// Whether the robot lies on the images.
    Agreement = "agreement": StageSpec {
        inputs: &[CLIP, ROBOT, Input::of(ROBOT_MODEL, Provider::Robot)],
        filled: &[("robot", Filled::RobotSpec)],
        figures: figures(1.0, 0.1, 150.0),
        outputs: &[Output::new("agreement", "agreement.r4c")],
        ..StageSpec::PLAIN
    };
    /// What a clip is scored against, where it comes without.
    References = "references": StageSpec {
        inputs: &[CLIP, ROBOT],
        figures: figures(5.0, 10.0, 300.0),
        outputs: &[Output::new("references", "references.r4c")],
        blind: true,
        asked: true,
        ..StageSpec::PLAIN
    };
    /// Stage 1: the field.
    Lift = "lift": StageSpec {
        inputs: &[
            CLIP,
            ROBOT,
            Input::of("conditioning", Provider::Stage(StageId::Conditioning)),
            // Their depth scales every camera. A clip with depth of its own does without.
            Input::when("references", Provider::Stage(StageId::References), When {
                param: "attention",
                is: "camera-wise",
                needed: None,
            }),
            Input::of("weights", Provider::Weights(WeightsRole::Lift)),
            Input::when("latents", Provider::Latents, When {
                param: "tokens",
                is: "latents",
                needed: Some(Needed {
                    what: "the clips' latents",
                    hint: "name their folder: [latents] with root = \"FOLDER\" (docs/latents-format.md)",
                }),
            }),
            Input::when("adapter", Provider::Weights(WeightsRole::Adapter), When {
                param: "tokens",
                is: "latents",
                needed: Some(Needed {
                    what: "an adapter",
                    hint: "name it under [weights]: adapter = \"FILE\"",
                }),
            }),
        ],
        filled: &[("weights", Filled::Weights(WeightsRole::Lift))],
        figures: figures(6.5, 95.0, 470.0),
        outputs: &[Output::new("lift", "field-1.r4c")],
        ..StageSpec::PLAIN
    };
    /// The baseline 4DGT: a field of its own kind.
    Lift4dgt = "lift-4dgt": StageSpec {
        inputs: &[
            CLIP,
            ROBOT,
            Input::of("weights", Provider::Weights(WeightsRole::FourDgt)),
            Input::of("encoder", Provider::Weights(WeightsRole::Dinov2)),
        ],
        filled: &[
            ("weights", Filled::Weights(WeightsRole::FourDgt)),
            ("encoder", Filled::Weights(WeightsRole::Dinov2)),
        ],
        figures: figures(400.0, 330.0, 4000.0),
        outputs: &[Output::new("lift-4dgt", "field-4dgt.r4c")],
        asked: true,
        ..StageSpec::PLAIN
    };
    /// The baseline Shape of Motion: an optimised field of every camera.
    LiftSom = "lift-som": StageSpec {
        inputs: &[
            CLIP,
            ROBOT,
            // Their depth brings the depth of the sidecars to metres.
            Input::of("references", Provider::Stage(StageId::References)),
            Input::of("sidecars", Provider::Sidecars),
        ],
        figures: figures(1150.0, 6.0, 400.0),
        outputs: &[Output::new("lift-som", "field-som.r4c")],
        asked: true,
        ..StageSpec::PLAIN
    };
    /// Stage 2: corrections of the field.
    Refine = "refine": StageSpec {
        inputs: &[
            CLIP,
            ROBOT,
            FIELD,
            Input::of("weights", Provider::Weights(WeightsRole::Refine)),
            Input::of("resume", Provider::Hand),
        ],
        filled: &[("weights", Filled::Weights(WeightsRole::Refine))],
        figures: figures(9.7, 90.0, 850.0),
        outputs: &[Output::new("refine", "field-2.r4c")],
        ..StageSpec::PLAIN
    };
    /// The field of one clip, optimised against its source images.
    Fit = "fit": StageSpec {
        inputs: &[
            CLIP,
            ROBOT,
            FIELD,
            Input::when("refinement", Provider::Stage(StageId::Refine), When {
                param: "start",
                is: "refined",
                needed: None,
            }),
        ],
        figures: figures(250.0, 95.0, 1500.0),
        outputs: &[Output::new("fit", "field-fit.r4c")],
        asked: true,
        ..StageSpec::PLAIN
    };
    /// Measures the field, the refined field, the fitted field, and outside methods.
    Score = "score": StageSpec {
        inputs: &[
            CLIP,
            ROBOT,
            FIELD,
            Input::of("references", Provider::Stage(StageId::References)),
            Input::of("refinement", Provider::Stage(StageId::Refine)),
            Input::of("fitted", Provider::Stage(StageId::Fit)),
            Input::of("polynomial", Provider::Stage(StageId::Lift4dgt)),
            Input::of("motion-bases", Provider::Stage(StageId::LiftSom)),
            Input::of("predictions", Provider::Predictions),
            Input::of("lpips", Provider::Weights(WeightsRole::Lpips)),
        ],
        filled: &[("method", Filled::Method), ("cross_view", Filled::HasRollouts)],
        figures: figures(1.8, 10.0, 850.0),
        outputs: &[
            Output {
                method: "stage1",
                skips: &["refinement", "fitted", "polynomial", "motion-bases", "predictions"],
                // The field after some updates is a row of the refined field alone.
                unless: Some("update"),
                ..Output::new("score-1", "scores-1.r4c")
            },
            Output {
                method: "stage1+2",
                skips: &["fitted", "polynomial", "motion-bases", "predictions"],
                ..Output::new("score-2", "scores-2.r4c")
            },
            Output {
                method: "fit",
                skips: &["field", "refinement", "polynomial", "motion-bases", "predictions"],
                // The field after some updates is a row of the refined field alone.
                unless: Some("update"),
                with: Some(StageId::Fit),
                ..Output::new("score-fit", "scores-fit.r4c")
            },
        ],
        ..StageSpec::PLAIN
    };
}

/// How the files of outside methods are scored.
pub static OUTSIDE: Outside = Outside {
    stage: StageId::Score,
    output: Output {
        skips: &["field", "refinement", "fitted", "polynomial", "motion-bases"],
        ..Output::new("score", "scores-1.r4c")
    },
    options: "prediction",
};

/// The baselines that run here.
pub static BASELINES: [BaselineSpec; 3] = [
    BaselineSpec {
        method: "movies",
        words: "MoVieS",
        lift: StageId::Lift,
        fixed: &[
            ("attention", Fixed::Word("camera-wise")),
            ("anchoring", Fixed::Off),
            ("fk_conditioning", Fixed::Off),
        ],
        weights: &[(WeightsRole::Lift, WeightsRole::Movies)],
        score: StageId::Score,
        output: Output {
            skips: &["refinement", "fitted", "polynomial", "motion-bases", "predictions"],
            ..Output::new("score", "scores-1.r4c")
        },
    },
    BaselineSpec {
        method: "4dgt",
        words: "4DGT",
        lift: StageId::Lift4dgt,
        fixed: &[],
        weights: &[
            (WeightsRole::FourDgt, WeightsRole::FourDgt),
            (WeightsRole::Dinov2, WeightsRole::Dinov2),
        ],
        score: StageId::Score,
        output: Output {
            skips: &["field", "refinement", "fitted", "motion-bases", "predictions"],
            ..Output::new("score", "scores-1.r4c")
        },
    },
    BaselineSpec {
        method: "som",
        words: "Shape of Motion",
        lift: StageId::LiftSom,
        fixed: &[],
        weights: &[],
        score: StageId::Score,
        output: Output {
            skips: &["field", "refinement", "fitted", "polynomial", "predictions"],
            ..Output::new("score", "scores-1.r4c")
        },
    },
];

impl BaselineSpec {
    /// The baseline of a name.
    #[must_use]
    pub fn by_method(method: &str) -> Option<&'static Self> {
        BASELINES.iter().find(|spec| spec.method == method)
    }

    /// The role of `[weights]` that stands in the place of a role of its stage.
    #[must_use]
    pub fn weights_of(&self, of: WeightsRole) -> WeightsRole {
        let own = self.weights.iter().find(|(place, _)| *place == of);
        own.map_or(of, |(_, role)| *role)
    }
}

impl StageId {
    /// These stages (where none is named, all that need not be asked for) and those that they need, in the order of the
    /// pipeline.
    #[must_use]
    pub fn with_producers(asked: &[Self]) -> Vec<Self> {
        let mut wanted: BTreeSet<Self> = if asked.is_empty() {
            Self::ALL.iter().copied().filter(|stage| !stage.spec().asked).collect()
        } else {
            asked.iter().copied().collect()
        };
        // Producers come before their readers, so one pass from the end finds them all.
        for &stage in Self::ALL.iter().rev() {
            if let (true, Some(first)) = (wanted.contains(&stage), stage.spec().outputs.first()) {
                wanted.extend(stage.spec().producers(first));
            }
        }
        wanted.into_iter().collect()
    }
}

impl fmt::Display for StageId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for StageId {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.iter().find(|stage| stage.name() == text);
        found.copied().ok_or_else(|| {
            let names: Vec<String> = Self::ALL.iter().map(|stage| format!("`{stage}`")).collect();
            format!("unknown stage `{text}`, expected one of {}", names.join(", "))
        })
    }
}

impl Serialize for StageId {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for StageId {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = Cow::<'de, str>::deserialize(deserializer)?;
        name.parse().map_err(serde::de::Error::custom)
    }
}

impl JsonSchema for StageId {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "StageId".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let names: Vec<&str> = Self::ALL.iter().map(|stage| stage.name()).collect();
        schemars::json_schema!({ "type": "string", "enum": names })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_comes_after_those_that_it_reads_from() {
        for &stage in StageId::ALL {
            let spec = stage.spec();
            let outside = (OUTSIDE.stage == stage).then_some(&OUTSIDE.output);
            let baselines = BASELINES.iter().filter(|own| own.score == stage).map(|own| &own.output);
            for output in spec.outputs.iter().chain(outside).chain(baselines) {
                assert!(spec.producers(output).all(|producer| producer < stage), "{stage}");
                let known = |role: &&str| spec.inputs.iter().any(|input| input.role == *role);
                assert!(output.skips.iter().all(known), "{stage} skips an unknown role");
            }
            assert!(!spec.outputs.is_empty(), "{stage} makes nothing");
        }
    }

    #[test]
    fn files_and_labels_are_unique_and_names_read_back() {
        let outputs: Vec<&Output> = StageId::ALL.iter().flat_map(|stage| stage.spec().outputs).collect();
        let files: BTreeSet<&str> = outputs.iter().map(|output| output.file).collect();
        let labels: BTreeSet<&str> = outputs.iter().map(|output| output.label).collect();
        assert_eq!((files.len(), labels.len()), (outputs.len(), outputs.len()));
        for &stage in StageId::ALL {
            assert_eq!(stage.name().parse(), Ok(stage));
        }
        let error = "lfit".parse::<StageId>().unwrap_err();
        assert!(
            error.starts_with("unknown stage `lfit`, expected one of `ingest`, "),
            "{error}"
        );
    }

    #[test]
    fn what_is_asked_for_brings_what_it_needs() {
        use StageId::{Conditioning, Fit, Ingest, Lift, Lift4dgt, LiftSom, References, Refine, RobotMaps, Score};
        let unasked: Vec<StageId> = (StageId::ALL.iter().copied())
            .filter(|&stage| ![References, Lift4dgt, LiftSom, Fit].contains(&stage))
            .collect();
        assert_eq!(StageId::with_producers(&[]), unasked);
        assert_eq!(StageId::with_producers(&[References]), [Ingest, RobotMaps, References]);
        assert_eq!(StageId::with_producers(&[RobotMaps]), [Ingest, RobotMaps]);
        assert_eq!(
            StageId::with_producers(&[Conditioning]),
            [Ingest, RobotMaps, Conditioning]
        );
        let up_to_lift = [Ingest, RobotMaps, Conditioning, Lift];
        assert_eq!(StageId::with_producers(&[Score]), [&up_to_lift[..], &[Score]].concat());
        assert_eq!(
            StageId::with_producers(&[Refine, Ingest]),
            [&up_to_lift[..], &[Refine]].concat()
        );
        assert_eq!(
            StageId::with_producers(&[Fit]),
            [&up_to_lift[..], &[Refine, Fit]].concat()
        );
    }
}
