//! `rogs metrics`: two images or two folders, without any manifest.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use rogs_lpips::Lpips;
use rogs_orchestrator::{Error, columns};
use rogs_schemas::shown;
use rogs_score::folders::{PairScores, score_paths};
use rogs_score::metrics::{Pixels, RgbView, SsimVariant};

use crate::output;

/// Scores images or depth maps without any manifest: two files, or two folders matched by file name.
///
/// Colours get PSNR, SSIM and, with weights, LPIPS; depth in metres gets AbsRel, RMSE and delta1 where the reference lies
/// between 0.1 and 5 m. Files are PNG or JPEG (colours; 16-bit grey PNG: depth in millimetres), OpenEXR (channels R, G, B:
/// colours in 0 to 1; Z: depth), npy, npz or safetensors (arrays [H, W, 3] or [T, H, W, 3]: colours, 8 bit or floats in 0 to
/// 1; [H, W] or [T, H, W]: depth).
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Prediction: a file, or a folder of files.
    prediction: PathBuf,
    /// Reference: the same.
    reference: PathBuf,
    /// SSIM variant: skimage-sample-cov (the default of the paper's evaluation code), skimage or torchmetrics.
    #[arg(long, default_value = "skimage-sample-cov", value_parser = variant)]
    ssim: SsimVariant,
    /// LPIPS weights (VGG16 features and linear heads, safetensors).
    #[arg(long, value_name = "FILE")]
    lpips: Option<PathBuf>,
    /// Metres that one step of the prediction's depth stands for, e.g. 0.001 for millimetres.
    #[arg(long, value_name = "METRES", value_parser = unit)]
    prediction_unit_m: Option<f64>,
    /// The same for the reference.
    #[arg(long, value_name = "METRES", value_parser = unit)]
    reference_unit_m: Option<f64>,
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

fn unit(text: &str) -> Result<f64, String> {
    let unit = text.trim().parse::<f64>().ok();
    unit.filter(|unit| (1e-9..1e3).contains(unit))
        .ok_or_else(|| "expected metres of one step, e.g. 0.001".to_owned())
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let lpips = match &args.lpips {
        Some(path) => Some(Lpips::open(path).map_err(|error| lpips_error(path, &error))?),
        None => None,
    };
    let features = |lpips: &Lpips, view: &RgbView<'_>| {
        let (height, width) = (view.height(), view.width());
        match view.pixels() {
            Pixels::Bytes(rgb) => lpips.features_of_bytes(rgb, height, width).ok(),
            Pixels::Unit(rgb) => lpips.features(rgb, height, width).ok(),
        }
    };
    let distance = |prediction: &RgbView<'_>, reference: &RgbView<'_>| -> Option<f64> {
        let lpips = lpips.as_ref()?;
        lpips
            .distance(&features(lpips, prediction)?, &features(lpips, reference)?)
            .ok()
    };
    let distance: Option<rogs_score::folders::Distance<'_>> = if lpips.is_some() { Some(&distance) } else { None };
    let units_m = [args.prediction_unit_m, args.reference_unit_m];
    let scores = score_paths(&args.prediction, &args.reference, args.ssim, distance, units_m)?;
    if args.json {
        output::json(&scores)?;
        return Ok(ExitCode::SUCCESS);
    }
    let number =
        |value: Option<f64>, digits: usize| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"));
    let column = |name, digits, value: fn(&PairScores) -> Option<f64>, mean, pairs| Column {
        name,
        digits,
        value,
        mean,
        pairs,
    };
    let n = scores.n;
    let all = [
        column("PSNR", 3, |pair| pair.psnr, scores.psnr, n.psnr),
        column("SSIM", 4, |pair| pair.ssim, scores.ssim, n.ssim),
        column("LPIPS", 4, |pair| pair.lpips, scores.lpips, n.lpips),
        column("AbsRel", 4, |pair| pair.absrel, scores.absrel, n.depth),
        column("RMSE m", 4, |pair| pair.rmse_m, scores.rmse_m, n.depth),
        column("delta1", 4, |pair| pair.delta1, scores.delta1, n.depth),
    ];
    // Colours alone need no columns of depth, and the other way round.
    let colours = scores.pairs.iter().any(|pair| pair.psnr.is_some());
    let depth = scores.pairs.iter().any(|pair| pair.support_n.is_some());
    let shown = if colours { 0 } else { 3 }..if depth { 6 } else { 3 };
    let shown = &all[shown];
    let line = |name: &str, cell: &dyn Fn(&Column) -> String| -> Vec<String> {
        std::iter::once(name.to_owned()).chain(shown.iter().map(cell)).collect()
    };
    let mut rows = vec![line("image", &|column| column.name.to_owned())];
    for pair in &scores.pairs {
        rows.push(line(&pair.name, &|column| number((column.value)(pair), column.digits)));
    }
    if scores.pairs.len() > 1 {
        rows.push(line("mean", &|column| number(column.mean, column.digits)));
        rows.push(line("pairs with a value", &|column| column.pairs.to_string()));
    }
    let mut text = columns(&rows).join("\n");
    text.push('\n');
    for pair in &scores.pairs {
        for note in &pair.notes {
            let _ = writeln!(text, "{}: {note}", shown::line(&pair.name));
        }
    }
    if colours {
        let _ = writeln!(text, "SSIM variant: {}", scores.ssim_variant);
    }
    if let Some(note) = scores.lpips_note.as_ref().filter(|_| colours) {
        let _ = writeln!(text, "LPIPS: {note}");
    }
    for (names, side) in [
        (&scores.only_in_prediction, "prediction"),
        (&scores.only_in_reference, "reference"),
    ] {
        if !names.is_empty() {
            let _ = writeln!(text, "only in the {side}: {}", shown::line(&names.join(", ")));
        }
    }
    output::text(&text)?;
    Ok(ExitCode::SUCCESS)
}

/// Weights that are none of LPIPS, with where to get them.
fn lpips_error(path: &Path, error: &rogs_lpips::Error) -> Error {
    let message = format!("`{}` holds no weights of LPIPS-VGG: {error}", path.display());
    Error::usage(message).with_hint(
        "it takes the convolutions of VGG16 and five heads, in one file or one folder: `rogs weights fetch vgg16` and `rogs \
         weights fetch lpips-vgg`",
    )
}

/// A column of the printed scores.
struct Column {
    name: &'static str,
    digits: usize,
    value: fn(&PairScores) -> Option<f64>,
    mean: Option<f64>,
    pairs: usize,
}
