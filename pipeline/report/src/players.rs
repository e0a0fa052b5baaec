//! Players of clips in a page.

use maud::{Markup, html};
use rogs_pages::Script;
use serde_json::json;

/// The viewer: one classic script that `viewer/bundle.mjs` makes.
const VIEWER: &str = include_str!("../viewer/viewer.js");

/// What pictures do without the viewer, which has it too.
const ENLARGE: &str = include_str!("../viewer/src/enlarge.js");
/// Players that a page shows at once; the others are folded.
const MOST_OPEN: usize = 6;

/// A clip that can be played.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Player {
    /// What the clip is called; shown as text.
    pub name: String,
    /// What can be shown side by side, by name.
    pub scenes: Vec<(String, SceneSource)>,
    /// What a person should know, e.g. why a scene is missing.
    pub notes: Vec<String>,
}

/// Where the viewer finds a scene.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SceneSource {
    /// A script beside the page.
    Script(String),
    /// An address of the server that the page comes from.
    Address(String),
}

/// A page, with the viewer where something can be played.
pub(crate) fn page(title: &str, style: &str, body: &Markup, players: &[Player], connects: bool) -> Markup {
    if players.iter().all(|player| player.scenes.is_empty()) {
        return rogs_pages::page(title, style, body);
    }
    let text = VIEWER;
    rogs_pages::page_with_script(title, style, body, Script { text, connects })
}

/// A page of pictures.
pub(crate) fn page_of_pictures(title: &str, style: &str, body: &Markup) -> Markup {
    let script = Script {
        text: ENLARGE,
        connects: false,
    };
    rogs_pages::page_with_script(title, style, body, script)
}

/// The players, one a clip; the first opens by itself. Of many, the others are folded.
pub(crate) fn section(players: &[Player]) -> Markup {
    let (shown, folded) = players.split_at(if players.len() > MOST_OPEN { 1 } else { players.len() });
    html! {
        @if players.len() > 1 {
            nav {
                @for (number, player) in (1..).zip(players) { a href=(format!("#player-{number}")) { (player.name) } }
            }
        }
        @for (number, player) in (1..).zip(shown) { (one(number, player)) }
        @if !folded.is_empty() {
            details {
                summary { (folded.len()) " more clips to play" }
                @for (number, player) in (shown.len() + 1..).zip(folded) { (one(number, player)) }
            }
        }
    }
}

fn one(number: usize, player: &Player) -> Markup {
    html! {
        section id=(format!("player-{number}")) {
            h2 { (player.name) }
            @for note in &player.notes { p.note { (note) } }
            @if !player.scenes.is_empty() { div.player data-scenes=(sources(player)) {} }
        }
    }
}

fn sources(player: &Player) -> String {
    let source = |(name, source): &(String, SceneSource)| match source {
        SceneSource::Script(script) => json!({ "name": name, "script": script }),
        SceneSource::Address(url) => json!({ "name": name, "url": url }),
    };
    serde_json::Value::from_iter(player.scenes.iter().map(source)).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_clips_and_scenes_are_text() {
        let name = "\"><script>alert(1)</script>".to_owned();
        let player = Player {
            name: name.clone(),
            scenes: vec![(name.clone(), SceneSource::Script("scenes/0001-1.js".into()))],
            notes: vec![name],
        };
        let players = [player];
        let page = page("<b>", "", &section(&players), &players, true).into_string();
        assert!(!page.contains("<script>alert") && !page.contains("<b>"));
        assert_eq!(page.matches("<script>").count(), 1);
        assert!(page.contains("connect-src 'self'"));
    }

    #[test]
    fn of_many_players_one_is_shown_and_the_others_are_folded() {
        let player = |number: usize| Player {
            name: format!("clip-{number}"),
            scenes: Vec::new(),
            notes: Vec::new(),
        };
        let many: Vec<Player> = (1..=MOST_OPEN + 1).map(player).collect();
        let html = section(&many).into_string();
        let (shown, folded) = html.split_once("<details>").unwrap();
        assert!(
            shown.contains("id=\"player-1\"") && !shown.contains("id=\"player-2\""),
            "{html}"
        );
        assert!(
            folded.contains("6 more clips") && folded.contains("id=\"player-7\""),
            "{html}"
        );
        assert!(!section(&many[1..]).into_string().contains("<details>"));
    }

    #[test]
    fn the_viewer_does_not_end_its_own_tag_and_keeps_the_licence() {
        assert!(!ENLARGE.contains('<') && ENLARGE.is_ascii());
        let lower = VIEWER.to_ascii_lowercase();
        assert!(!lower.contains("</script") && !lower.contains("<!--") && VIEWER.is_ascii());
        assert!(lower.contains("three.js authors") && lower.contains("permission is hereby granted"));
    }

    #[test]
    fn a_page_without_players_has_no_script() {
        assert!(!page("x", "", &html! {}, &[], true).into_string().contains("script"));
    }
}
