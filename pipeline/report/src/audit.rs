//! What an audit says of many clips: verdicts, as lines, for scripts, and as a page.

use std::path::{Path, PathBuf};

use maud::{Markup, html};
use rogs_orchestrator::{Result, columns};
use rogs_r4c::read_record;
use rogs_schemas::records::agreement::{
    Agreements, CameraAgreement, Estimate, Offset, TriedMistake, Verdict, ViewAgreement,
};
use rogs_schemas::records::clip::{Clip, ROLLOUT};
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::shown;
use schemars::JsonSchema;
use serde::Serialize;

use crate::page::{STYLE, agreement};
use crate::pictures;
use crate::results::RunResults;

/// Clips whose pictures a page has.
const PICTURES: usize = 24;

/// The verdicts of some runs.
#[derive(Debug, Default)]
pub struct Audit {
    /// Clips, in the order of their plans.
    pub clips: Vec<AuditedClip>,
    /// Clips that could not be audited, with the reason.
    pub failures: Vec<(String, String)>,
}

/// A clip and its verdicts.
#[derive(Debug)]
pub struct AuditedClip {
    /// Id of the clip.
    pub id: String,
    /// What was found out.
    pub agreements: Agreements,
    /// The clip's file and that of its robot maps.
    files: [Option<PathBuf>; 2],
}

impl Audit {
    /// Takes in the clips of a run.
    ///
    /// # Errors
    /// When it is none, or cannot be read.
    pub fn add(&mut self, run: &Path) -> Result<()> {
        for clip in RunResults::read(run)?.clips {
            let mut failures: Vec<String> = (clip.failures.iter())
                .map(|own| format!("{}: {}", own.node, own.failure.message))
                .collect();
            for path in &clip.agreements {
                match read_record::<Agreements>(path) {
                    Ok((agreements, _)) => {
                        let generated = agreements.setting == ROLLOUT;
                        let images = if generated { &clip.rollout } else { &clip.clip };
                        self.clips.push(AuditedClip {
                            id: clip.id.clone(),
                            files: [images.clone(), clip.robot.clone()],
                            agreements,
                        });
                    }
                    Err(error) => failures.push(error.to_string()),
                }
            }
            if clip.agreements.is_empty() && failures.is_empty() {
                failures.push("it has not been audited yet".to_owned());
            }
            self.failures
                .extend(failures.into_iter().map(|why| (clip.id.clone(), why)));
        }
        Ok(())
    }

    fn cameras(&self) -> impl Iterator<Item = (&AuditedClip, &CameraAgreement)> {
        let clips = self.clips.iter();
        clips.flat_map(|clip| clip.agreements.cameras.iter().map(move |camera| (clip, camera)))
    }

    /// How many cameras have each verdict, in words.
    #[must_use]
    pub fn summary(&self) -> String {
        let counts = Verdict::ALL.map(|verdict| {
            let count = self.cameras().filter(|(_, camera)| camera.verdict == verdict).count();
            format!("{count} {verdict}")
        });
        format!(
            "{} cameras of {} clips: {}",
            self.cameras().count(),
            self.clips.len(),
            counts.join(", ")
        )
    }

    /// A line a camera, those that failed, and the summary.
    #[must_use]
    pub fn text(&self) -> String {
        let head = ["clip", "camera", "verdict", "offset px", "mm", "overlay", "lag"];
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        let mut causes = vec!["likely mistake".to_owned()];
        let number =
            |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |value| format!("{value:.digits$}"));
        for (clip, camera) in self.cameras() {
            rows.push(vec![
                clip.id.clone(),
                camera.name.clone(),
                camera.verdict.to_string(),
                number(camera.offset.map(|offset| offset.px), 1),
                number(camera.offset.map(|offset| 1000.0 * offset.m), 0),
                number(Some(camera.overlay), 2),
                number(camera.lag_frames.map(|lag| lag.value), 1),
            ]);
            causes.push(agreement::cause(camera));
        }
        let lines = columns(&rows);
        let wide = lines.iter().map(|line| line.chars().count()).max().unwrap_or(0);
        let mut out: Vec<String> = (lines.iter().zip(&causes))
            .map(|(line, cause)| format!("{line:wide$}  {}", shown::line(cause)).trim_end().to_owned())
            .collect();
        let failed = |(clip, why): &(String, String)| format!("failed: {clip}: {}", shown::line(why));
        out.extend(self.failures.iter().map(failed));
        out.push(self.summary());
        out.join("\n")
    }

    /// The same for scripts.
    #[must_use]
    pub fn told(&self) -> ToldAudit {
        let failure = |(clip, why): &(String, String)| ToldFailure {
            clip: clip.clone(),
            message: why.clone(),
        };
        ToldAudit {
            clips: self.clips.iter().map(ToldClip::of).collect(),
            failures: self.failures.iter().map(failure).collect(),
        }
    }

    /// The same as one page without scripts, with the drawn outlines on the images of the worst clips.
    #[must_use]
    pub fn page(&self, title: &str) -> String {
        let mut clips: Vec<&AuditedClip> = self.clips.iter().collect();
        clips.sort_by_key(|clip| clip.worst());
        let body = html! {
            p { (self.summary()) }
            @for (clip, why) in &self.failures { div.failure { b { (shown::line(clip)) } ": " (shown::line(why)) } }
            p.note {
                "Cyan: the outline of the robot as calibration and joint states say. Clips in which something is wrong come \
                 first."
            }
            @for (number, clip) in clips.iter().enumerate() {
                details open[number == 0 || clip.worst() < 2] {
                    summary { (shown::line(&clip.id)) " (" (clip.agreements.setting) ")" }
                    (agreement::table(&clip.agreements))
                    @if number < PICTURES { (overlays(clip)) }
                }
            }
        };
        shown::text(&rogs_pages::page(title, STYLE, &body).into_string()).into_owned()
    }
}

impl AuditedClip {
    /// The worst verdict of its cameras: 0 wrong, 1 suspect, 2 cannot be told, 3 good.
    fn worst(&self) -> u8 {
        let rank = |camera: &CameraAgreement| match camera.verdict {
            Verdict::Wrong => 0,
            Verdict::Suspect => 1,
            Verdict::CannotTell => 2,
            Verdict::Good => 3,
        };
        self.agreements.cameras.iter().map(rank).min().unwrap_or(3)
    }
}

/// An audit for scripts.
#[derive(Debug, Serialize, JsonSchema)]
pub struct ToldAudit {
    /// The clips that were audited.
    clips: Vec<ToldClip>,
    /// Those that could not be.
    failures: Vec<ToldFailure>,
}

/// A clip that could not be audited.
#[derive(Debug, Serialize, JsonSchema)]
struct ToldFailure {
    /// Id of the clip.
    clip: String,
    /// What went wrong.
    message: String,
}

/// A clip that was audited.
#[derive(Debug, Serialize, JsonSchema)]
struct ToldClip {
    /// Id of the clip.
    clip: String,
    /// What its images are: `recorded` or `rollout`.
    setting: String,
    /// Its source cameras.
    cameras: Vec<ToldCamera>,
}

/// What was found out about a camera.
#[derive(Debug, Serialize, JsonSchema)]
struct ToldCamera {
    /// Its name.
    camera: String,
    /// In short.
    verdict: Verdict,
    /// The likely mistake; null where there is none, or none is known.
    mistake: Option<TriedMistake>,
    /// Why it cannot be told; empty where it can.
    why: String,
    /// Share of the silhouette that has its edge at the predicted place: about 0 by chance, 1 for a perfect overlay.
    overlay: f64,
    /// Median offset over frames.
    offset: Option<Offset>,
    /// The suppositions that fit best, best first.
    tried: Vec<TriedMistake>,
    /// Frames by which the robot of the images lags behind the states.
    lag_frames: Option<Estimate>,
    /// How far the robot of the images has gone from the drawn one from the first frame to the last, metres.
    drift_m: Option<Estimate>,
    /// What each frame tells.
    frames: Vec<ToldFrame>,
}

/// One frame of a camera; null where it cannot be told.
#[derive(Debug, Serialize, JsonSchema)]
struct ToldFrame {
    /// Why it cannot be told; empty where it can.
    why: &'static str,
    /// Where the robot of the image lies as seen from the drawn one, right and down, pixels.
    shift_px: Option<[f32; 2]>,
    /// Standard deviation of the length of the shift, pixels.
    sigma_px: Option<f32>,
    /// Length of the shift at the robot's depth, across the line of sight, metres.
    offset_m: Option<f32>,
    /// Its standard deviation, metres.
    sigma_m: Option<f32>,
    /// As for the camera.
    overlay: Option<f32>,
}

impl ToldClip {
    fn of(clip: &AuditedClip) -> Self {
        Self {
            clip: clip.id.clone(),
            setting: clip.agreements.setting.clone(),
            cameras: clip.agreements.cameras.iter().map(ToldCamera::of).collect(),
        }
    }
}

impl ToldCamera {
    fn of(own: &CameraAgreement) -> Self {
        let frame = |view: &ViewAgreement| {
            let number = |value: f32| value.is_finite().then_some(value);
            ToldFrame {
                why: view.state.words(),
                shift_px: view
                    .shift_px
                    .iter()
                    .all(|value| value.is_finite())
                    .then_some(view.shift_px),
                sigma_px: number(view.sigma_px),
                offset_m: number(view.offset_m),
                sigma_m: number(view.sigma_m),
                overlay: number(view.overlay),
            }
        };
        Self {
            camera: own.name.clone(),
            verdict: own.verdict,
            mistake: own.mistake.clone(),
            why: own.why.clone(),
            overlay: own.overlay,
            offset: own.offset,
            tried: own.tried.clone(),
            lag_frames: own.lag_frames,
            drift_m: own.drift_m,
            frames: own.views.iter().map(frame).collect(),
        }
    }
}

/// Images with the drawn outline, a strip a camera.
fn overlays(clip: &AuditedClip) -> Markup {
    let [images, robot] = &clip.files;
    let records = images.as_deref().zip(robot.as_deref()).and_then(|(images, robot)| {
        let images = read_record::<Clip>(images).ok()?.0;
        Some((images, read_record::<RobotMaps>(robot).ok()?.0))
    });
    html! {
        @if let Some((images, robot)) = &records {
            @for camera in &clip.agreements.cameras {
                @if let Some(figure) = pictures::overlay(images, robot, &camera.name) {
                    figure {
                        figcaption { (figure.caption) ": " (camera.verdict) }
                        (rogs_pages::picture(&figure.caption, figure.media_type, &figure.bytes))
                    }
                }
            }
        } @else {
            p.note { "Its images cannot be read." }
        }
    }
}
