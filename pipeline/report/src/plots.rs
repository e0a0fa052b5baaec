//! Plots over the clips of a run: what refinement updates do, and each clip under every method against the baseline.

use std::collections::{BTreeMap, BTreeSet};

use rogs_pages::{Bars, Plot, PlotPoint, Series};
use rogs_schemas::records::agreement::{Agreements, ViewState};
use rogs_schemas::records::scores::ScoreSheet;
use rogs_score::metrics::{bootstrap_interval, mean};
use rogs_score::summary::{ImageMetric, Metric, clip_value};
use rogs_score::tables::heading;

/// Clips that a plot of clips shows at least: of fewer, a table says as much.
const LEAST_CLIPS: usize = 3;

/// Methods of rogs, as they are made one of another.
const OWN: [&str; 3] = ["stage1", "stage1+2", "fit"];

/// Methods that are compared, with the baseline first: those that are not variants of another.
fn plain_methods(sheets: &[ScoreSheet]) -> Vec<&str> {
    let names: BTreeSet<&str> = sheets
        .iter()
        .map(|sheet| sheet.method.as_str())
        .filter(|method| !method.contains('/'))
        .collect();
    let mut methods: Vec<&str> = names.into_iter().collect();
    methods.sort_by_key(|method| *method != "stage1");
    methods
}

/// The plots that have something to show, in order.
pub(crate) fn plots(sheets: &[ScoreSheet]) -> Vec<Plot> {
    let metrics = [
        (Metric::Source(ImageMetric::Psnr), "source PSNR, dB"),
        (Metric::Novel(ImageMetric::Psnr), "novel PSNR, dB"),
        (Metric::Novel(ImageMetric::AbsRel), "novel AbsRel"),
        (Metric::RobotEpe, "robot EPE, mm"),
    ];
    let mut plots = Vec::new();
    for (metric, label) in metrics {
        plots.push(recurrence_plot(sheets, metric, label));
    }
    let methods = plain_methods(sheets);
    for (metric, label) in metrics {
        plots.push(clip_plot(sheets, &methods, metric, label));
    }
    plots.retain(|plot| !plot.series.is_empty());
    plots
}

/// Mean over clips after 0, 1, ... refinement updates (methods `stage1+2/rN`), a line a setting.
fn recurrence_plot(sheets: &[ScoreSheet], metric: Metric, label: &str) -> Plot {
    let mut by_setting: BTreeMap<&str, BTreeMap<u32, Vec<f64>>> = BTreeMap::new();
    for sheet in sheets {
        let update = sheet
            .method
            .strip_prefix("stage1+2/r")
            .and_then(|update| update.parse().ok());
        if let (Some(update), Some(value)) = (update, clip_value(sheet, metric)) {
            let by_update = by_setting.entry(&sheet.setting).or_default();
            by_update.entry(update).or_default().push(value);
        }
    }
    let point = |(update, values): (u32, Vec<f64>)| {
        let y = mean(&values)?;
        Some(PlotPoint {
            x: f64::from(update),
            y,
            name: format!("{update} updates, {} clips", values.len()),
            ..PlotPoint::default()
        })
    };
    let several = by_setting.len() > 1;
    let series = by_setting.into_iter().map(|(setting, by_update)| Series {
        label: if several { heading(setting) } else { String::new() },
        points: by_update.into_iter().filter_map(point).collect(),
    });
    Plot {
        title: format!("Refinement updates: {label}"),
        x_label: "updates".to_owned(),
        y_label: label.to_owned(),
        series: series.filter(|series| series.points.len() > 1).collect(),
        lines: true,
        ..Plot::default()
    }
}

/// Every clip: the baseline's value against that of each other method; with one method, its values in the order of clips.
fn clip_plot(sheets: &[ScoreSheet], methods: &[&str], metric: Metric, label: &str) -> Plot {
    let of = |method: &str| -> BTreeMap<(&str, &str), f64> {
        let own = sheets.iter().filter(|sheet| sheet.method == method);
        own.filter_map(|sheet| {
            Some((
                (sheet.setting.as_str(), sheet.clip_id.as_str()),
                clip_value(sheet, metric)?,
            ))
        })
        .collect()
    };
    let mut plot = Plot {
        title: format!("Clips: {label}"),
        y_label: label.to_owned(),
        ..Plot::default()
    };
    let Some((first, others)) = methods.split_first() else {
        return plot;
    };
    let base = of(first);
    if others.is_empty() {
        plot.x_label = "clip".to_owned();
        let points = base.iter().zip(1u32..).map(|(((_, clip), &y), x)| PlotPoint {
            x: f64::from(x),
            y,
            name: (*clip).to_owned(),
            ..PlotPoint::default()
        });
        plot.series.push(Series {
            label: (*first).to_owned(),
            points: points.collect(),
        });
    } else {
        plot.x_label = format!("{first}: {label}");
        plot.diagonal = true;
        for method in others {
            let points = of(method).into_iter().filter_map(|(key, y)| {
                let x = *base.get(&key)?;
                let name = key.1.to_owned();
                Some(PlotPoint {
                    x,
                    y,
                    name,
                    ..PlotPoint::default()
                })
            });
            plot.series.push(Series {
                label: (*method).to_owned(),
                points: points.collect(),
            });
        }
    }
    plot.series.retain(|series| series.points.len() >= LEAST_CLIPS);
    plot
}

/// What is plotted over the frames of the clips: frame, and the value of each clip.
type OverFrames = BTreeMap<u32, Vec<f64>>;

/// What a world model does over the horizon, a line a setting, each point the mean over clips with its interval: the
/// robot's distance from the commanded one, and how well the views agree with each other. Recorded frames are the floor.
pub(crate) fn rollout_plots(agreements: &[Agreements], sheets: &[ScoreSheet]) -> Vec<Plot> {
    let mut off: BTreeMap<String, OverFrames> = BTreeMap::new();
    for clip in agreements {
        let own = off.entry(heading(&clip.setting)).or_default();
        for frame in 0..clip.frame_count {
            let views = clip
                .cameras
                .iter()
                .filter_map(|camera| camera.views.get(frame as usize));
            let told = views.filter(|view| view.state == ViewState::Measured);
            let lengths: Vec<f64> = told
                .map(|view| f64::from(view.shift_px[0].hypot(view.shift_px[1])))
                .collect();
            own.entry(frame).or_default().extend(mean(&lengths));
        }
    }
    let mut agree: BTreeMap<String, OverFrames> = BTreeMap::new();
    for sheet in sheets.iter().filter(|sheet| !sheet.method.contains('/')) {
        let name = format!("{}, {}", sheet.method, heading(&sheet.setting));
        let frames: BTreeSet<u32> = sheet.cross_view.iter().map(|own| own.frame.0).collect();
        for frame in frames {
            let views = sheet.cross_view.iter().filter(|own| own.frame.0 == frame);
            let values: Vec<f64> = views.filter_map(|own| own.psnr).collect();
            let own = agree.entry(name.clone()).or_default();
            own.entry(frame).or_default().extend(mean(&values));
        }
    }
    let titles = [
        ("Action following: distance of the robot from the commanded one", "px"),
        (
            "Cross-view consistency: each view from the field of the others",
            "PSNR, dB",
        ),
    ];
    let plots = titles.into_iter().zip([off, agree]);
    plots
        .map(|((title, label), series)| Plot {
            title: title.to_owned(),
            x_label: "frame".to_owned(),
            y_label: label.to_owned(),
            series: series
                .into_iter()
                .map(|(label, frames)| Series {
                    label,
                    points: frames.into_iter().filter_map(over_clips).collect(),
                })
                .filter(|series| !series.points.is_empty())
                .collect(),
            lines: true,
            ..Plot::default()
        })
        .filter(|plot| !plot.series.is_empty())
        .collect()
}

/// The mean over clips at a frame with its interval; `None` of nothing.
fn over_clips((frame, values): (u32, Vec<f64>)) -> Option<PlotPoint> {
    let interval = bootstrap_interval(&values)?;
    Some(PlotPoint {
        x: f64::from(frame),
        y: interval.mean,
        name: format!("frame {frame}, {} clips", values.len()),
        interval: (values.len() > 1).then_some([interval.low, interval.high]),
    })
}

/// The means of the main table by method, a group of bars a setting, for metrics that some method has.
pub(crate) fn bars(sheets: &[ScoreSheet]) -> Vec<Bars> {
    let metrics = [
        (Metric::Source(ImageMetric::Psnr), "source PSNR, dB", "higher is better"),
        (Metric::Novel(ImageMetric::Psnr), "novel PSNR, dB", "higher is better"),
        (Metric::Novel(ImageMetric::AbsRel), "novel AbsRel", "lower is better"),
        (Metric::RobotEpe, "robot EPE, mm", "lower is better"),
    ];
    let mut methods = plain_methods(sheets);
    // Those of others come first, as in the tables of the paper.
    methods.sort_by_key(|method| OWN.iter().position(|own| own == method));
    let settings: BTreeSet<&str> = sheets.iter().map(|sheet| sheet.setting.as_str()).collect();
    let of = |metric: Metric, setting: &str| -> Vec<(String, f64)> {
        let bar = |method: &&str| {
            let own = sheets
                .iter()
                .filter(|sheet| sheet.method == **method && sheet.setting == setting);
            let values: Vec<f64> = own.filter_map(|sheet| clip_value(sheet, metric)).collect();
            Some(((*method).to_owned(), mean(&values)?))
        };
        methods.iter().filter_map(bar).collect()
    };
    let made = metrics.into_iter().map(|(metric, label, better)| Bars {
        title: format!("Methods: {label} ({better})"),
        label: label.to_owned(),
        groups: settings
            .iter()
            .map(|setting| (heading(setting), of(metric, setting)))
            .collect(),
    });
    made.filter(|bars| bars.groups.iter().map(|(_, bars)| bars.len()).sum::<usize>() > 1)
        .collect()
}
