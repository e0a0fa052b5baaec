//! What scores were measured against, in words: depth from a stereo network and depth from a classical matcher are not the
//! same reference, nor are tracks from forward kinematics and tracks from a tracker.

use std::collections::{BTreeMap, BTreeSet};

use rogs_schemas::records::origin::{ReferenceKind, ReferenceOrigin};
use rogs_schemas::records::scores::ScoreSheet;

/// The different origins of the references of a kind that a sheet has numbers from; not stated where it has numbers but
/// does not say.
#[must_use]
pub fn origins(sheet: &ScoreSheet, kind: ReferenceKind) -> BTreeSet<ReferenceOrigin> {
    let own = sheet.references.iter().filter(|used| used.kind == kind);
    let mut origins: BTreeSet<ReferenceOrigin> = own.map(|used| used.origin).collect();
    let measured = match kind {
        ReferenceKind::Depth => sheet.images.iter().any(|image| image.absrel.is_some()),
        ReferenceKind::Tracks => sheet.tracks.iter().any(|track| track.epe_mm.is_some()),
    };
    if measured && origins.is_empty() {
        origins.insert(ReferenceOrigin::NotStated);
    }
    origins
}

/// What one sheet was measured against, a line a kind.
#[must_use]
pub fn described(sheet: &ScoreSheet) -> Vec<String> {
    notes(&[sheet], &[ReferenceKind::Depth, ReferenceKind::Tracks], |label, _| {
        label.to_owned()
    })
}

/// What sheets were measured against, a note a kind, with the number of clips of every origin.
pub(crate) fn counted(sheets: &[&ScoreSheet], kinds: &[ReferenceKind]) -> Vec<String> {
    notes(sheets, kinds, |label, clips| format!("{label} (n={clips})"))
}

fn notes(sheets: &[&ScoreSheet], kinds: &[ReferenceKind], one: impl Fn(&str, usize) -> String) -> Vec<String> {
    let note = |&kind: &ReferenceKind| {
        let mut clips: BTreeMap<ReferenceOrigin, BTreeSet<&str>> = BTreeMap::new();
        for sheet in sheets {
            for origin in origins(sheet, kind) {
                clips.entry(origin).or_default().insert(sheet.clip_id.as_str());
            }
        }
        let what = match kind {
            ReferenceKind::Depth => "depth references",
            ReferenceKind::Tracks => "track references",
        };
        let list: Vec<String> = clips
            .iter()
            .map(|(origin, ids)| one(origin.label(), ids.len()))
            .collect();
        (!list.is_empty()).then(|| format!("{what}: {}", list.join(", ")))
    };
    kinds.iter().filter_map(note).collect()
}
