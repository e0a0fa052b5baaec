//! Bars as inline SVG: one a name, side by side in groups.

use maud::{Markup, html};

use crate::axis::Axis;
use crate::plot::{BOTTOM, COLOURS, HEIGHT, LEFT, RIGHT, TOP, WIDTH, tenths};

/// Bars of the same names in one or several groups.
#[derive(Debug, Clone, Default)]
pub struct Bars {
    /// Heading.
    pub title: String,
    /// What the height is, with its unit.
    pub label: String,
    /// Groups from left to right: heading, and names with heights. A name has one colour in all groups.
    pub groups: Vec<(String, Vec<(String, f64)>)>,
}

impl Bars {
    /// The bars under their heading; `None` when there is no finite one.
    #[must_use]
    pub fn figure(&self) -> Option<Markup> {
        let heights = self.finite().map(|(_, _, height)| height);
        let axis = Axis::over(heights.chain([0.0])).filter(|_| self.finite().next().is_some())?;
        let names = self.names();
        let colour = |name: &str| {
            let place = names.iter().position(|own| *own == name).unwrap_or(0);
            COLOURS[place % COLOURS.len()]
        };
        // As many slots as bars, and one more between two groups.
        let slots = self.finite().count() + self.groups.len().saturating_sub(1);
        let width = (RIGHT - LEFT) / slots as f64;
        let floor = axis.at(0.0, BOTTOM, TOP);
        Some(html! {
            figure {
                figcaption { (self.title) }
                svg role="img" aria-label=(self.title) viewBox={ "0 0 " (WIDTH) " " (HEIGHT) } width=(WIDTH)
                    height=(HEIGHT) font-size="11" font-family="system-ui,sans-serif" fill="currentColor"
                {
                    @for tick in axis.ticks() {
                        @let at = axis.at(tick, BOTTOM, TOP);
                        path d={ "M" (LEFT) " " (tenths(at)) "H" (RIGHT) } stroke="currentColor" stroke-opacity=".15" {}
                        text x=(tenths(LEFT - 5.0)) y=(tenths(at + 4.0)) text-anchor="end" { (axis.text(tick)) }
                    }
                    text transform={ "translate(13 " (tenths((TOP + BOTTOM) / 2.0)) ") rotate(-90)" }
                        text-anchor="middle" { (self.label) }
                    @for (slot, name, height) in self.placed() {
                        @let top = axis.at(height, BOTTOM, TOP);
                        rect x=(tenths(LEFT + (slot + 0.1) * width)) y=(tenths(top.min(floor)))
                            width=(tenths(0.8 * width)) height=(tenths((top - floor).abs())) fill=(colour(name))
                        { title { (format!("{name}: {height:.4}")) } }
                    }
                    @for (centre, heading) in self.headings() {
                        text x=(tenths(LEFT + centre * width)) y=(tenths(HEIGHT - 26.0)) text-anchor="middle" { (heading) }
                    }
                }
                p.legend {
                    @for name in &names { span style={ "color:" (colour(name)) } { "■ " } (name) " " }
                }
            }
        })
    }

    /// Names in the order in which they first stand.
    fn names(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for (_, name, _) in self.finite() {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names
    }

    /// Group, name and height of every bar that has one.
    fn finite(&self) -> impl Iterator<Item = (usize, &str, f64)> {
        let groups = self.groups.iter().enumerate();
        let bars =
            groups.flat_map(|(group, (_, bars))| bars.iter().map(move |(name, height)| (group, &**name, *height)));
        bars.filter(|(_, _, height)| height.is_finite())
    }

    /// Slot, name and height of every bar.
    fn placed(&self) -> impl Iterator<Item = (f64, &str, f64)> {
        let bars = self.finite().enumerate();
        bars.map(|(number, (group, name, height))| ((number + group) as f64, name, height))
    }

    /// The middle of every group, in slots, and its heading.
    fn headings(&self) -> Vec<(f64, &str)> {
        let mut headings = Vec::new();
        let mut before = 0;
        for (group, (heading, _)) in self.groups.iter().enumerate() {
            let own = self.finite().filter(|(of, ..)| *of == group).count();
            if own > 0 {
                headings.push(((before + group) as f64 + own as f64 / 2.0, &**heading));
            }
            before += own;
        }
        headings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_finite_bar_is_drawn_from_zero_in_the_colour_of_its_name() {
        let bar = |name: &str, height: f64| (name.to_owned(), height);
        let bars = Bars {
            title: "PSNR".into(),
            label: "dB".into(),
            groups: vec![
                ("recorded".into(), vec![bar("a<b", 20.0), bar("ours", 22.0)]),
                ("rollout".into(), vec![bar("a<b", f64::NAN), bar("ours", 21.0)]),
            ],
        };
        let drawn = bars.figure().unwrap().into_string();
        assert_eq!(drawn.matches("<rect").count(), 3);
        assert!(drawn.contains("a&lt;b: 20.0000") && drawn.contains("recorded") && drawn.contains("rollout"));
        assert_eq!(
            drawn.matches(&format!("fill=\"{}\"", COLOURS[1])).count(),
            2,
            "ours in both groups"
        );
        assert!(drawn.contains(">0<"), "the axis has a zero: {drawn}");
        assert!(Bars::default().figure().is_none());
    }
}
