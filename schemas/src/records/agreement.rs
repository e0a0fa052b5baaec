//! Agreement: does the robot, drawn from mesh and joint states, lie on the robot of the images?

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::check::{Check, count, ensure, product};
use crate::ids::ClipId;
use crate::index::CameraIndex;

/// Written by `agreement`: how far the robot of the images is off the drawn one, and which mistake explains it
/// (`docs/spec/agreement.md`).
#[derive(Debug, Clone, PartialEq)]
pub struct Agreements {
    /// The clip this belongs to.
    pub clip_id: ClipId,
    /// What the images are: `recorded` or `rollout`.
    pub setting: String,
    /// Number of frames of the clip, F.
    pub frame_count: u32,
    /// Names of the links, as in the robot maps. `[L]`
    pub link_names: Vec<String>,
    /// The source cameras, in order.
    pub cameras: Vec<CameraAgreement>,
}

/// What was found out about a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraAgreement {
    /// Index into the clip's cameras.
    pub camera: CameraIndex,
    /// Its name.
    pub name: String,
    /// In short.
    pub verdict: Verdict,
    /// The likely mistake, where it is not good and one is known.
    pub mistake: Option<TriedMistake>,
    /// Why it cannot be told; empty where it can.
    pub why: String,
    /// Share of the silhouette that has its edge at the predicted place: about 0 by chance, 1 for a perfect overlay.
    pub overlay: f64,
    /// Median offset over frames; `None` where no frame tells.
    pub offset: Option<Offset>,
    /// The suppositions that fit best, best first; empty where none had to be tried.
    pub tried: Vec<TriedMistake>,
    /// Frames by which the robot of the images lags behind the states; of cameras that stand still.
    pub lag_frames: Option<Estimate>,
    /// How far the robot of the images has gone from the drawn one between the first and the last frame, beyond the lag,
    /// metres across the line of sight.
    pub drift_m: Option<Estimate>,
    /// What each frame tells. `[F]`
    pub views: Vec<ViewAgreement>,
    /// Median distance of a link's edges from where they should be, along their normals, pixels; NaN where fewer than 6
    /// are found. `[F, L]`
    pub link_px: Vec<f32>,
    /// The same at the depth of the edges, metres. `[F, L]`
    pub link_m: Vec<f32>,
}

/// One frame of a camera. Numbers are NaN where it cannot be told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewAgreement {
    /// Whether it can be told, or why not.
    pub state: ViewState,
    /// Where the robot of the image lies as seen from the drawn one, right and down, pixels.
    pub shift_px: [f32; 2],
    /// Standard deviation of the length of the shift, pixels.
    pub sigma_px: f32,
    /// Length of the shift at the robot's depth, across the line of sight, metres.
    pub offset_m: f32,
    /// Its standard deviation, metres.
    pub sigma_m: f32,
    /// As [`CameraAgreement::overlay`].
    pub overlay: f32,
}

/// A distance with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Offset {
    /// In the image, pixels.
    pub px: f64,
    /// Standard deviation of that, pixels.
    pub sigma_px: f64,
    /// At the robot's depth, across the line of sight, metres.
    pub m: f64,
}

/// A number with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Estimate {
    /// The number.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// A supposition about what is wrong, and how well it fits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct TriedMistake {
    /// Short name, for scripts.
    pub name: String,
    /// In words, with what to do.
    pub words: String,
    /// Overlay under it.
    pub overlay: f64,
}

/// What is said of a camera, in short.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// The robot lies on the images.
    Good,
    /// It lies beside them by little, or nothing tried fits.
    Suspect,
    /// It does not, and a supposition fits much better.
    Wrong,
    /// It cannot be told.
    CannotTell,
}

impl Verdict {
    /// Every verdict.
    pub const ALL: [Self; 4] = [Self::Good, Self::Suspect, Self::Wrong, Self::CannotTell];

    /// Its name in files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Suspect => "suspect",
            Self::Wrong => "wrong",
            Self::CannotTell => "cannot-tell",
        }
    }

    /// What people read.
    #[must_use]
    pub const fn label(self) -> &'static str {
        match self {
            Self::CannotTell => "cannot tell",
            other => other.name(),
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.label())
    }
}

impl FromStr for Verdict {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|verdict| verdict.name() == text);
        found.ok_or_else(|| format!("unknown verdict `{text}`"))
    }
}

/// Whether a frame tells anything.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ViewState {
    /// It does.
    Measured,
    /// The robot is hardly in view.
    HardlyVisible,
    /// The image is of one brightness.
    BlankImage,
    /// Too few edges stand out near the drawn robot.
    TooFewEdges,
    /// There is no image.
    NoImage,
}

impl ViewState {
    /// Every state, by its number in files.
    pub const ALL: [Self; 5] = [
        Self::Measured,
        Self::HardlyVisible,
        Self::BlankImage,
        Self::TooFewEdges,
        Self::NoImage,
    ];

    /// Its number in files.
    #[must_use]
    pub fn number(self) -> u8 {
        self as u8
    }

    /// The state of a number.
    #[must_use]
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }

    /// In words; empty where it tells.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Measured => "",
            Self::HardlyVisible => "the robot is hardly in view",
            Self::BlankImage => "the image is blank",
            Self::TooFewEdges => "too few edges stand out near the drawn robot",
            Self::NoImage => "there is no image",
        }
    }
}

impl ViewAgreement {
    /// A frame that does not tell.
    #[must_use]
    pub const fn unknown(state: ViewState) -> Self {
        Self {
            state,
            shift_px: [f32::NAN; 2],
            sigma_px: f32::NAN,
            offset_m: f32::NAN,
            sigma_m: f32::NAN,
            overlay: f32::NAN,
        }
    }
}

impl Agreements {
    /// The arrays agree with the counts, and every number is possible.
    ///
    /// # Errors
    /// What contradicts what, in words.
    pub fn check(&self) -> Check {
        let (frames, links) = (self.frame_count as usize, self.link_names.len());
        ensure((1..=65_536).contains(&frames), || format!("{frames} frames"))?;
        ensure(links <= 255, || format!("{links} links"))?;
        let ascending = self.cameras.is_sorted_by(|a, b| a.camera < b.camera);
        ensure(ascending, || "the cameras do not ascend".into())?;
        for camera in &self.cameras {
            camera
                .check(frames, links)
                .map_err(|what| format!("camera `{}`: {what}", camera.name))?;
        }
        Ok(())
    }
}

impl CameraAgreement {
    fn check(&self, frames: usize, links: usize) -> Check {
        ensure(self.camera.at() < 255, || "there is no such camera".into())?;
        count("views", self.views.len(), frames)?;
        let values = product("links", &[frames, links])?;
        count("link distances in pixels", self.link_px.len(), values)?;
        count("link distances in metres", self.link_m.len(), values)?;
        let offset = self.offset.map(|offset| [offset.px, offset.sigma_px, offset.m]);
        let estimates = [self.lag_frames, self.drift_m];
        let estimates = estimates
            .into_iter()
            .flatten()
            .flat_map(|own| [own.value.abs(), own.sigma]);
        let tried = self.tried.iter().chain(&self.mistake).map(|tried| tried.overlay.abs());
        let mut all = offset
            .into_iter()
            .flatten()
            .chain(estimates)
            .chain(tried)
            .chain([self.overlay.abs()]);
        ensure(all.all(|value| value.is_finite() && value >= 0.0), || {
            "a number is negative or not finite".into()
        })?;
        let told = |view: &ViewAgreement| {
            let [x, y] = view.shift_px;
            let values = [x, y, view.sigma_px, view.offset_m, view.sigma_m, view.overlay];
            match view.state {
                ViewState::Measured => values.iter().all(|value| value.is_finite()),
                _ => values.iter().all(|value| value.is_nan()),
            }
        };
        ensure(self.views.iter().all(told), || {
            "a frame that tells has no numbers, or one that does not has some".into()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record() -> Agreements {
        let told = ViewAgreement {
            state: ViewState::Measured,
            shift_px: [0.5, -0.25],
            sigma_px: 0.1,
            offset_m: 0.002,
            sigma_m: 0.001,
            overlay: 0.7,
        };
        Agreements {
            clip_id: "clip".parse().unwrap(),
            setting: "recorded".into(),
            frame_count: 2,
            link_names: vec!["a".into()],
            cameras: vec![CameraAgreement {
                camera: CameraIndex(0),
                name: "wrist".into(),
                verdict: Verdict::Good,
                mistake: None,
                why: String::new(),
                overlay: 0.7,
                offset: Some(Offset {
                    px: 0.5,
                    sigma_px: 0.1,
                    m: 0.002,
                }),
                tried: vec![],
                lag_frames: None,
                drift_m: None,
                views: vec![told, ViewAgreement::unknown(ViewState::BlankImage)],
                link_px: vec![0.5, f32::NAN],
                link_m: vec![0.002, f32::NAN],
            }],
        }
    }

    #[test]
    fn numbers_where_nothing_is_told_are_refused() {
        record().check().unwrap();
        let mut wrong = record();
        wrong.cameras[0].views[1].overlay = 0.1;
        assert!(wrong.check().unwrap_err().contains("camera `wrist`: a frame"));
        let mut wrong = record();
        wrong.cameras[0].link_m.pop();
        assert!(wrong.check().unwrap_err().contains("expected 2"));
        let mut wrong = record();
        wrong.cameras[0].overlay = f64::NAN;
        assert!(wrong.check().unwrap_err().contains("not finite"));
    }

    #[test]
    fn verdicts_and_states_read_back() {
        for verdict in Verdict::ALL {
            assert_eq!(verdict.name().parse(), Ok(verdict));
        }
        for state in ViewState::ALL {
            assert_eq!(ViewState::from_number(state.number()), Some(state));
        }
        assert_eq!(ViewState::from_number(5), None);
    }
}
