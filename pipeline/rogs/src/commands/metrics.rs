//! `rogs metrics`: two images or two folders, without any manifest.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use rogs_networks::lpips::Lpips;
use rogs_score::folders::score_paths;
use rogs_score::metrics::SsimVariant;

use crate::output;

/// PSNR, SSIM and (with weights) LPIPS of a prediction against a reference: two image files, or two folders matched by
/// file name.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Prediction: a PNG or JPEG file, or a folder of them.
    prediction: PathBuf,
    /// Reference.
    reference: PathBuf,
    /// SSIM variant: skimage-sample-cov (the default of the paper's evaluation code), skimage or torchmetrics.
    #[arg(long, default_value = "skimage-sample-cov", value_parser = variant)]
    ssim: SsimVariant,
    /// LPIPS weights (VGG16 features and linear heads, safetensors).
    #[arg(long, value_name = "FILE")]
    lpips: Option<PathBuf>,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

fn variant(name: &str) -> Result<SsimVariant, String> {
    let all = [
        SsimVariant::SkimageSampleCov,
        SsimVariant::Skimage,
        SsimVariant::Torchmetrics,
    ];
    let found = all.into_iter().find(|variant| variant.name() == name);
    found.ok_or_else(|| format!("variants are {}", all.map(SsimVariant::name).join(", ")))
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let lpips = match &args.lpips {
        Some(path) => Some(Lpips::open(path)?),
        None => None,
    };
    let distance = |prediction: &[u8], reference: &[u8], height: usize, width: usize| -> Option<f64> {
        let lpips = lpips.as_ref()?;
        let features = |rgb: &[u8]| lpips.features_of_bytes(rgb, height, width).ok();
        lpips.distance(&features(prediction)?, &features(reference)?).ok()
    };
    let distance: Option<rogs_score::folders::Distance<'_>> = if lpips.is_some() { Some(&distance) } else { None };
    let scores = score_paths(&args.prediction, &args.reference, args.ssim, distance)?;
    if args.json {
        output::json(&scores)?;
        return Ok(ExitCode::SUCCESS);
    }
    let number =
        |value: Option<f64>, digits: usize| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"));
    let mut text = format!("{:<40} {:>9} {:>8} {:>8}\n", "image", "PSNR", "SSIM", "LPIPS");
    for pair in &scores.pairs {
        let _ = writeln!(
            text,
            "{:<40} {:>9.3} {:>8} {:>8}",
            pair.name,
            pair.psnr,
            number(pair.ssim, 4),
            number(pair.lpips, 4)
        );
    }
    if scores.pairs.len() > 1 {
        let _ = writeln!(
            text,
            "{:<40} {:>9} {:>8} {:>8}",
            "mean",
            number(scores.psnr, 3),
            number(scores.ssim, 4),
            number(scores.lpips, 4)
        );
    }
    if let Some(note) = &scores.lpips_note {
        let _ = writeln!(text, "LPIPS: {note}");
    }
    for (names, side) in [
        (&scores.only_in_prediction, "prediction"),
        (&scores.only_in_reference, "reference"),
    ] {
        if !names.is_empty() {
            let _ = writeln!(text, "only in the {side}: {}", names.join(", "));
        }
    }
    output::text(&text)?;
    Ok(ExitCode::SUCCESS)
}
