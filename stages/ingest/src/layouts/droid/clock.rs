//! Which image and which state belong together: cameras and robot are read one after the other, each with a time.

use std::path::Path;

use rogs_worker::StageResult;

use crate::checks;
use crate::params::IdleSteps;

/// DROID's control rate, steps per second.
const RATE: f64 = 15.0;
/// Clocks that differ by more have nothing to do with each other, milliseconds.
const UNRELATED: f64 = 2000.0;
/// A state further from its image than this is told, milliseconds.
const FAR: f64 = 34.0;

/// Frames of an episode in terms of rows of the trajectory.
#[derive(Debug)]
pub(super) struct Clock {
    /// Frames per second.
    pub(super) fps: f64,
    /// For every camera, the frame of its video for each episode frame.
    pub(super) frames: Vec<Vec<u64>>,
    /// The row of the trajectory whose state belongs to each episode frame.
    pub(super) states: Vec<usize>,
    /// For the report.
    pub(super) note: String,
    pub(super) warnings: Vec<String>,
}

/// What is known of a camera's time.
pub(super) struct CameraTime<'a> {
    pub(super) id: &'a str,
    /// Frames of its video that have a row.
    pub(super) frames: usize,
    /// Frames per second in the header of its video.
    pub(super) header_fps: f64,
    pub(super) capture_ms: Option<&'a [f64]>,
}

/// Matches images and states. Frame k of a video is step k of the trajectory; the first camera sets the times, and the
/// others and the states are the nearest to them.
pub(super) fn matched(
    cameras: &[CameraTime<'_>],
    state_ms: Option<&[f64]>,
    idle: &[bool],
    choice: IdleSteps,
    path: &Path,
) -> StageResult<Clock> {
    let mut warnings = Vec::new();
    let count = cameras.iter().map(|camera| camera.frames).min().unwrap_or(0);
    let mut ascending = |times: Option<&'_ [f64]>, what: &str| -> Option<Vec<f64>> {
        let times = times?;
        if times.is_sorted_by(|a, b| a < b) {
            return Some(times.to_vec());
        }
        warnings.push(format!(
            "`{}`: the times of {what} do not ascend: taken step by step instead",
            path.display()
        ));
        None
    };
    let camera_ms: Vec<Option<Vec<f64>>> = cameras
        .iter()
        .map(|camera| ascending(camera.capture_ms, &format!("camera `{}`", camera.id)))
        .collect();
    let state_ms = ascending(state_ms, "the robot");
    let reference = camera_ms
        .first()
        .cloned()
        .flatten()
        .map(|times| times[..count].to_vec());
    let mut notes = Vec::new();
    let states = match (&reference, &state_ms) {
        (Some(times), Some(states)) => {
            let (rows, text, far) = nearest(times, states, "the robot's state");
            warnings.extend(far);
            notes.extend(text);
            rows
        }
        _ => {
            warnings.push(format!(
                "`{}` has no times of both images and states: image k is taken with the state of step k",
                path.display()
            ));
            (0..count).collect()
        }
    };
    let mut frames = Vec::new();
    for (camera, times) in cameras.iter().zip(&camera_ms) {
        let rows = match (&reference, times) {
            (Some(reference), Some(times)) => {
                let (rows, _, far) = nearest(
                    reference,
                    &times[..camera.frames],
                    &format!("the image of `{}`", camera.id),
                );
                warnings.extend(far);
                rows
            }
            _ => (0..count).collect(),
        };
        frames.push(rows.into_iter().map(|row| row as u64).collect::<Vec<u64>>());
    }
    let kept = kept_frames(count, idle, choice, &mut notes, &mut warnings);
    let fps = rate(cameras, reference.as_deref(), path, &mut warnings);
    if let Some(times) = &reference {
        let seconds: Vec<f64> = kept.iter().map(|&frame| (times[frame] - times[0]) / 1000.0).collect();
        warnings.extend(checks::times(&seconds, fps, path)?);
    }
    Ok(Clock {
        fps,
        frames: frames
            .iter()
            .map(|frames| kept.iter().map(|&frame| frames[frame]).collect())
            .collect(),
        states: kept.iter().map(|&frame| states[frame]).collect(),
        note: notes.join("; "),
        warnings,
    })
}

/// Frames that stay, with a word about those in which nobody moved the robot.
fn kept_frames(
    count: usize,
    idle: &[bool],
    choice: IdleSteps,
    notes: &mut Vec<String>,
    warnings: &mut Vec<String>,
) -> Vec<usize> {
    let resting = |frame: &usize| idle.get(*frame).copied().unwrap_or(false);
    let found = (0..count).filter(resting).count();
    if found == 0 {
        return (0..count).collect();
    }
    match choice {
        IdleSteps::Keep => {
            notes.push(format!("{found} of {count} steps are idle and kept"));
            (0..count).collect()
        }
        IdleSteps::Drop => {
            warnings.push(format!(
                "{found} of {count} steps are idle and left out, images and states alike"
            ));
            (0..count).filter(|frame| !resting(frame)).collect()
        }
    }
}

/// Frames per second: DROID's where the times agree, else what they say; without times, the header's.
fn rate(cameras: &[CameraTime<'_>], times: Option<&[f64]>, path: &Path, warnings: &mut Vec<String>) -> f64 {
    let usual = |fps: f64| if (fps / RATE - 1.0).abs() < 0.05 { RATE } else { fps };
    let header = cameras.iter().map(|camera| camera.header_fps).find(|&fps| fps > 0.0);
    let mut steps: Vec<f64> = times
        .unwrap_or_default()
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .collect();
    steps.sort_by(f64::total_cmp);
    let fps = match (steps.get(steps.len() / 2), header) {
        (Some(&step), _) => usual(1000.0 / step),
        (None, Some(fps)) => usual(fps),
        (None, None) => RATE,
    };
    for camera in cameras {
        if camera.header_fps > 0.0 && (camera.header_fps / fps - 1.0).abs() > 0.1 {
            warnings.push(format!(
                "the video of `{}` says {:.4} frames per second, its times {fps:.4}: the times are taken",
                camera.id, camera.header_fps
            ));
        }
    }
    if (fps / RATE - 1.0).abs() > 0.1 {
        warnings.push(format!(
            "`{}`: it runs at {fps:.4} steps per second, DROID at {RATE}",
            path.display()
        ));
    }
    fps
}

/// For every time the row of the nearest of `others`, what to say about the offsets, and a warning where one is large.
fn nearest(times: &[f64], others: &[f64], what: &str) -> (Vec<usize>, Option<String>, Option<String>) {
    let rows: Vec<usize> = times.iter().map(|&time| nearest_row(others, time)).collect();
    let mut offsets: Vec<f64> = rows
        .iter()
        .zip(times)
        .map(|(&row, time)| (others[row] - time).abs())
        .collect();
    offsets.sort_by(f64::total_cmp);
    let (Some(&median), Some(&most)) = (offsets.get(offsets.len() / 2), offsets.last()) else {
        return (rows, None, None);
    };
    if median > UNRELATED {
        let text = format!(
            "{what} is {:.1} s away from the image: the clocks have nothing to do with each other, taken step by step",
            median / 1000.0
        );
        return (
            (0..times.len()).map(|row| row.min(others.len() - 1)).collect(),
            None,
            Some(text),
        );
    }
    let mut shifts: Vec<i64> = rows.iter().zip(0..).map(|(&row, frame)| row as i64 - frame).collect();
    shifts.sort_unstable();
    let shift = shifts[shifts.len() / 2];
    let text = format!("{what} is {median:.0} ms from the image in the median, {most:.0} ms at most");
    let steps = (shift != 0).then(|| format!("{what} nearest in time is that of {shift:+} steps ({median:.0} ms)"));
    let far = (most > FAR).then(|| text.clone());
    (rows, Some(text), steps.or(far))
}

/// Row of the value nearest to `time`, the earlier one of two; `others` ascends and is not empty.
fn nearest_row(others: &[f64], time: f64) -> usize {
    let after = others.partition_point(|&other| other < time).min(others.len() - 1);
    match after.checked_sub(1) {
        Some(before) if time - others[before] <= (others[after] - time).abs() => before,
        _ => after,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera<'a>(id: &'a str, frames: usize, capture_ms: Option<&'a [f64]>) -> CameraTime<'a> {
        CameraTime {
            id,
            frames,
            header_fps: 15.0,
            capture_ms,
        }
    }

    fn every(count: usize, start: f64) -> Vec<f64> {
        (0..count)
            .map(|step| start + (step as f64 * 1000.0 / 15.0).round())
            .collect()
    }

    #[test]
    fn the_nearest_state_is_taken_and_its_offset_told() {
        let (wrist, ext, robot) = (every(20, 1000.0), every(20, 1010.0), every(20, 872.0));
        let cameras = [camera("wrist", 19, Some(&wrist)), camera("ext1", 20, Some(&ext))];
        let clock = matched(&cameras, Some(&robot), &[false; 20], IdleSteps::Keep, Path::new("t.h5")).unwrap();
        assert_eq!(clock.fps, 15.0);
        assert_eq!(clock.frames[0], (0..19).collect::<Vec<u64>>());
        assert_eq!(clock.frames[1], clock.frames[0]);
        // 128 ms are two steps; the last one has no state so late.
        assert_eq!(clock.states[..3], [2, 3, 4]);
        assert_eq!(clock.states[18], 19);
        assert!(
            clock.warnings.iter().any(|text| text.contains("+2 steps")),
            "{:?}",
            clock.warnings
        );
    }

    #[test]
    fn clocks_of_other_worlds_fall_back_to_steps() {
        let (wrist, robot) = (every(20, 1e12), every(20, 5.0));
        let cameras = [camera("wrist", 20, Some(&wrist))];
        let clock = matched(&cameras, Some(&robot), &[], IdleSteps::Keep, Path::new("t.h5")).unwrap();
        assert_eq!(clock.states, (0..20).collect::<Vec<usize>>());
        assert!(
            clock
                .warnings
                .iter()
                .any(|text| text.contains("nothing to do with each other"))
        );
        let none = matched(
            &[camera("wrist", 20, None)],
            None,
            &[],
            IdleSteps::Keep,
            Path::new("t.h5"),
        )
        .unwrap();
        assert!(none.warnings[0].contains("no times"), "{:?}", none.warnings);
        let back: Vec<f64> = wrist.iter().rev().copied().collect();
        let cameras = [camera("wrist", 20, Some(&back))];
        let clock = matched(&cameras, Some(&robot), &[], IdleSteps::Keep, Path::new("t.h5")).unwrap();
        assert!(clock.warnings.iter().any(|text| text.contains("do not ascend")));
    }

    #[test]
    fn idle_steps_are_kept_or_left_out_as_asked() {
        let wrist = every(10, 0.0);
        let cameras = [camera("wrist", 10, Some(&wrist))];
        let idle: Vec<bool> = (0..10).map(|step| step == 2 || step == 3).collect();
        let with = |choice| matched(&cameras, Some(&wrist), &idle, choice, Path::new("t.h5")).unwrap();
        let kept = with(IdleSteps::Keep);
        assert_eq!(kept.states.len(), 10);
        assert!(kept.note.contains("2 of 10 steps are idle"), "{}", kept.note);
        let dropped = with(IdleSteps::Drop);
        assert_eq!(dropped.states, [0, 1, 4, 5, 6, 7, 8, 9]);
        assert_eq!(dropped.frames[0], [0, 1, 4, 5, 6, 7, 8, 9]);
        assert!(dropped.warnings.iter().any(|text| text.contains("left out")));
    }

    #[test]
    fn rates_that_differ_are_told() {
        let wrist = every(10, 0.0);
        let mut cameras = [camera("wrist", 10, Some(&wrist))];
        cameras[0].header_fps = 60.0;
        let clock = matched(&cameras, Some(&wrist), &[], IdleSteps::Keep, Path::new("t.h5")).unwrap();
        assert_eq!(clock.fps, 15.0);
        assert!(
            clock.warnings[0].contains("says 60.0000 frames per second"),
            "{:?}",
            clock.warnings
        );
    }
}
