//! How far an optimisation is, for whoever watches it: what lies beside an output in the making.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::key::CacheKey;

/// Figures of an optimisation after some of its updates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Figures {
    /// The part that is worked at, such as a camera, where the whole has several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<String>,
    /// Updates done.
    pub update: u32,
    /// Updates in all, of the part where there is one.
    pub updates: u32,
    /// Loss of the last update.
    pub loss: f64,
    /// Mean PSNR of the source views, each as it was last rendered, dB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source_psnr_db: Option<f64>,
}

impl Figures {
    /// `update 25 of 100, loss 0.0512, source views 25.31 dB`
    #[must_use]
    pub fn words(&self) -> String {
        let part = self.part.as_ref().map_or_else(String::new, |part| format!("{part}: "));
        let seen = self.source_psnr_db;
        let seen = seen.map_or_else(String::new, |psnr| format!(", source views {psnr:.2} dB"));
        format!(
            "{part}update {} of {}, loss {:.4}{seen}",
            self.update, self.updates, self.loss
        )
    }
}

/// The figures of an output in the making, as they lie beside it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Interim {
    /// Key of the output.
    pub key: CacheKey,
    /// How far it is.
    #[serde(flatten)]
    pub figures: Figures,
}

/// Endings of what lies beside an output in the making, and goes when it is there: what a killed job resumes from.
pub const STATE: &str = "progress.r4c";
/// The [`Interim`] as JSON.
pub const FIGURES: &str = "progress.json";
/// Observed images and renders.
pub const PICTURE: &str = "progress.png";
/// All of them.
pub const ENDINGS: [&str; 3] = [STATE, FIGURES, PICTURE];

/// Where a file of one of the [`ENDINGS`] lies: `field-fit.progress.png` beside `field-fit.r4c`.
#[must_use]
pub fn beside(output: &Path, ending: &str) -> PathBuf {
    output.with_extension(ending)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_told_in_words_and_kept_as_json() {
        let mut figures = Figures {
            part: None,
            update: 25,
            updates: 100,
            loss: 0.05124,
            source_psnr_db: None,
        };
        assert_eq!(figures.words(), "update 25 of 100, loss 0.0512");
        figures.part = Some("ext1".into());
        figures.source_psnr_db = Some(25.307);
        assert_eq!(
            figures.words(),
            "ext1: update 25 of 100, loss 0.0512, source views 25.31 dB"
        );
        let key = CacheKey([7; 16]);
        let interim = Interim { key, figures };
        let text = serde_json::to_string(&interim).unwrap();
        assert_eq!(serde_json::from_str::<Interim>(&text).unwrap(), interim, "{text}");
        let picture = beside(Path::new("clips/a/field-fit.r4c"), PICTURE);
        assert_eq!(picture, Path::new("clips/a/field-fit.progress.png"));
    }
}
