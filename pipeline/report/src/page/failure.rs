//! A failure on the page.

use maud::{Markup, html};
use rogs_schemas::ledger::Failure;
use rogs_schemas::shown;

/// Where it happened, what, and what to do.
pub(super) fn failure(place: &str, failure: &Failure) -> Markup {
    html! {
        div.failure {
            b { (place) } ": " (shown::line(&failure.message))
            @if let Some(hint) = &failure.hint { br; "→ " (shown::line(hint)) }
        }
    }
}
