//! Whether the robot lies on the images of a clip: a row a camera.

use maud::{Markup, html};
use rogs_schemas::records::agreement::{Agreements, CameraAgreement, Estimate};
use rogs_schemas::shown;

/// The verdicts of a clip.
pub(crate) fn table(agreements: &Agreements) -> Markup {
    html! {
        h3 { "Does the robot lie on the images?" }
        table.facts {
            tr {
                th { "camera" } th { "verdict" } th { "offset" } th { "overlay" } th { "lag, frames" } th { "drift, mm" }
                th { "likely mistake" }
            }
            @for camera in &agreements.cameras { (row(camera)) }
        }
    }
}

fn row(camera: &CameraAgreement) -> Markup {
    html! {
        tr {
            td { (shown::line(&camera.name)) }
            td { (camera.verdict) }
            td { (offset(camera)) }
            td { (format!("{:.2}", camera.overlay)) }
            td { (estimate(camera.lag_frames, 1.0)) }
            td { (estimate(camera.drift_m, 1000.0)) }
            td { (shown::line(&cause(camera))) }
        }
    }
}

/// Median offset of a camera.
fn offset(camera: &CameraAgreement) -> String {
    camera.offset.map_or_else(
        || "–".to_owned(),
        |offset| {
            format!(
                "{:.1} ± {:.1} px ({:.0} mm)",
                offset.px,
                offset.sigma_px,
                1000.0 * offset.m
            )
        },
    )
}

/// The likely mistake, or why it cannot be told; empty where all is well.
pub(crate) fn cause(camera: &CameraAgreement) -> String {
    match &camera.mistake {
        Some(mistake) => format!("{} (overlay {:.2} without that)", mistake.words, mistake.overlay),
        None => camera.why.clone(),
    }
}

fn estimate(own: Option<Estimate>, unit: f64) -> String {
    own.map_or_else(
        || "–".to_owned(),
        |own| format!("{:.1} ± {:.1}", unit * own.value, unit * own.sigma),
    )
}
