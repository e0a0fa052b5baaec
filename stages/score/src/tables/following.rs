//! How the robot of the images follows the commanded one (`docs/spec/scoring.md` section 13).

use std::collections::BTreeSet;

use rogs_schemas::records::agreement::{Agreements, CameraAgreement, ViewState};

use crate::metrics::bootstrap_interval;
use crate::tables::id::TableId;
use crate::tables::input::{RECORDED, ROLLOUT, heading};
use crate::tables::table::{Better, Cell, Column, Row, Table};

/// One number of a camera in a clip; `None` where it cannot be told.
type Value = fn(&CameraAgreement) -> Option<f64>;

const COLUMNS: [(&str, usize, Value); 6] = [
    ("error (px)", 2, |own| own.offset.map(|offset| offset.px)),
    ("error (mm)", 1, |own| own.offset.map(|offset| 1000.0 * offset.m)),
    ("last frames (px)", 2, last_frames),
    ("worst link (mm)", 1, worst_link),
    ("lag (frames)", 2, |own| own.lag_frames.map(|lag| lag.value)),
    ("drift (mm)", 1, |own| own.drift_m.map(|drift| 1000.0 * drift.value)),
];

/// Makes the table: a row a camera, and one for all of them, recorded frames and rollouts apart, each mean with its interval.
pub(super) fn table(agreements: &[Agreements]) -> Table {
    let column = |(name, digits, _): (&'static str, usize, Value)| Column {
        digits,
        better: Some(Better::Lower),
        ..Column::plain(name)
    };
    let mut rows = Vec::new();
    for setting in [RECORDED, ROLLOUT] {
        let own: Vec<&Agreements> = agreements.iter().filter(|own| own.setting == setting).collect();
        if own.is_empty() {
            continue;
        }
        let names: BTreeSet<&str> = (own.iter())
            .flat_map(|own| own.cameras.iter().map(|camera| camera.name.as_str()))
            .collect();
        for name in names {
            rows.push(row(setting, name, &own, &|camera| camera.name == name));
        }
        rows.push(row(setting, "all cameras", &own, &|_| true));
    }
    let footnotes = if rows.is_empty() {
        vec!["nothing was measured: the stage `agreement` makes it".to_owned()]
    } else {
        vec![
            "the robot as commanded, drawn from its mesh, against the images; medians over frames, means over clips"
                .to_owned(),
            "recorded frames are the floor: what calibration and joint states leave".to_owned(),
        ]
    };
    Table {
        id: TableId::Following,
        title: "Action following",
        columns: COLUMNS.into_iter().map(column).collect(),
        rows,
        footnotes,
        counted: true,
    }
}

fn row(setting: &str, label: &str, agreements: &[&Agreements], takes: &dyn Fn(&CameraAgreement) -> bool) -> Row {
    // Clips are independent, the cameras of one are not: a clip gives the mean over its cameras.
    let of_clip = |clip: &&Agreements, value: Value| {
        let values: Vec<f64> = (clip.cameras.iter())
            .filter(|own| takes(own))
            .filter_map(value)
            .collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let cell = |(_, _, value): (&str, usize, Value)| {
        let values: Vec<f64> = agreements.iter().filter_map(|clip| of_clip(clip, value)).collect();
        if values.is_empty() {
            return Cell::Missing;
        }
        let interval = bootstrap_interval(&values);
        Cell::Mean {
            value: values.iter().sum::<f64>() / values.len() as f64,
            clips: values.len(),
            interval: interval.map(|own| [own.low, own.high]),
            digits: None,
        }
    };
    let clips = agreements.iter().filter(|clip| clip.cameras.iter().any(takes));
    Row {
        group: heading(setting),
        label: label.to_owned(),
        method: label.to_owned(),
        clips: clips.count(),
        untrained: false,
        cells: COLUMNS.into_iter().map(cell).collect(),
        published: &[],
    }
}

/// Median length of the shift over the last quarter of the frames, pixels.
fn last_frames(camera: &CameraAgreement) -> Option<f64> {
    let first = camera.views.len() - camera.views.len().div_ceil(4);
    let told = camera.views[first..]
        .iter()
        .filter(|view| view.state == ViewState::Measured);
    median(
        told.map(|view| f64::from(view.shift_px[0].hypot(view.shift_px[1])))
            .collect(),
    )
}

/// Over the links the largest of their medians over the frames, millimetres.
fn worst_link(camera: &CameraAgreement) -> Option<f64> {
    let frames = camera.views.len().max(1);
    let links = camera.link_m.len() / frames;
    let of_link = |link: usize| {
        let values = camera
            .link_m
            .iter()
            .skip(link)
            .step_by(links.max(1))
            .filter(|m| m.is_finite());
        median(values.map(|m| 1000.0 * f64::from(*m)).collect())
    };
    (0..links).filter_map(of_link).reduce(f64::max)
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use rogs_schemas::CameraIndex;
    use rogs_schemas::records::agreement::{Estimate, Offset, Verdict, ViewAgreement};

    use super::*;

    fn clip(id: &str, setting: &str, px: f64, lag: Option<f64>) -> Agreements {
        let view = |at: usize| ViewAgreement {
            state: ViewState::Measured,
            shift_px: [at as f32, 0.0],
            sigma_px: 0.1,
            offset_m: 0.001,
            sigma_m: 0.0001,
            overlay: 0.5,
        };
        Agreements {
            clip_id: id.parse().unwrap(),
            setting: setting.into(),
            frame_count: 8,
            link_names: vec!["a".into(), "b".into()],
            cameras: vec![CameraAgreement {
                camera: CameraIndex(1),
                name: "ext1".into(),
                verdict: Verdict::Good,
                mistake: None,
                why: String::new(),
                overlay: 0.5,
                offset: Some(Offset {
                    px,
                    sigma_px: 0.1,
                    m: 0.001 * px,
                }),
                tried: vec![],
                lag_frames: lag.map(|value| Estimate { value, sigma: 0.1 }),
                drift_m: None,
                views: (0..8).map(view).collect(),
                link_px: vec![1.0; 16],
                link_m: [0.001, 0.003].repeat(8),
            }],
        }
    }

    #[test]
    fn recorded_frames_are_the_floor_beside_rollouts() {
        let agreements = [
            clip("a", RECORDED, 0.5, None),
            clip("b", RECORDED, 1.5, Some(0.0)),
            clip("a", ROLLOUT, 4.0, Some(2.0)),
        ];
        let made = table(&agreements);
        let rows: Vec<(&str, &str, usize)> = (made.rows.iter())
            .map(|row| (row.group.as_str(), row.label.as_str(), row.clips))
            .collect();
        let [recorded, rollouts] = ["Recorded observations", "World-model rollouts"];
        assert_eq!(
            rows,
            [
                (recorded, "ext1", 2),
                (recorded, "all cameras", 2),
                (rollouts, "ext1", 1),
                (rollouts, "all cameras", 1)
            ]
        );
        let values = |row: usize| -> Vec<Option<f64>> { made.rows[row].cells.iter().map(Cell::value).collect() };
        let floor = values(0);
        assert_eq!(floor[0], Some(1.0));
        assert!((floor[1].unwrap() - 1.0).abs() < 1e-9);
        assert_eq!((floor[2], floor[4], floor[5]), (Some(7.0), Some(0.0), None));
        assert!((floor[3].unwrap() - 3.0).abs() < 1e-6);
        assert_eq!(values(2)[4], Some(2.0));
        assert!(table(&[]).rows.is_empty());
    }
}
