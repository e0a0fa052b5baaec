//! A failure on the page.

use maud::{Markup, html};
use rogs_schemas::ledger::Failure;

/// Where it happened, what, and what to do.
pub(super) fn failure(place: &str, failure: &Failure) -> Markup {
    html! {
        div.failure {
            b { (place) } ": " (failure.message)
            @if let Some(hint) = &failure.hint { br; "→ " (hint) }
        }
    }
}
