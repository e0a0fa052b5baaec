//! Plots as inline SVG: axes, points, lines, a legend. Colours of text and axes follow the page.

use maud::{Markup, html};

use crate::axis::Axis;

/// A plot.
#[derive(Debug, Clone, Default)]
pub struct Plot {
    /// Heading.
    pub title: String,
    /// What x is, with its unit.
    pub x_label: String,
    /// What y is, with its unit.
    pub y_label: String,
    /// What is drawn.
    pub series: Vec<Series>,
    /// Join the points of a series by lines.
    pub lines: bool,
    /// Leave the points themselves out: for series of many.
    pub bare: bool,
    /// Draw x = y.
    pub diagonal: bool,
}

/// The points of one method.
#[derive(Debug, Clone, Default)]
pub struct Series {
    /// Name in the legend.
    pub label: String,
    /// Points with what a reader sees when pointing at one.
    pub points: Vec<PlotPoint>,
}

/// One point.
#[derive(Debug, Clone, Default)]
pub struct PlotPoint {
    /// Horizontal.
    pub x: f64,
    /// Vertical.
    pub y: f64,
    /// Name, for example of the clip.
    pub name: String,
    /// Lower and upper end of its interval, drawn as a bar; `None`: none.
    pub interval: Option<[f64; 2]>,
}

pub(crate) const WIDTH: f64 = 420.0;
pub(crate) const HEIGHT: f64 = 300.0;
/// Edges of the area that is drawn in.
pub(crate) const LEFT: f64 = 58.0;
pub(crate) const RIGHT: f64 = WIDTH - 12.0;
pub(crate) const TOP: f64 = 10.0;
pub(crate) const BOTTOM: f64 = HEIGHT - 42.0;
/// Colours that people with colour-blindness can tell apart, on light and dark ground.
pub(crate) const COLOURS: [&str; 7] = [
    "#0f7fc4", "#d55e00", "#009e73", "#cc79a7", "#e0a400", "#56b4e9", "#8a6fd1",
];

impl Plot {
    /// The plot under its heading; `None` when there is no point to draw.
    #[must_use]
    pub fn figure(&self) -> Option<Markup> {
        let svg = self.svg()?;
        Some(html! { figure { figcaption { (self.title) } (svg) } })
    }

    fn svg(&self) -> Option<Markup> {
        let (x, y) = self.axes()?;
        let coloured = || self.series.iter().zip(COLOURS.iter().copied().cycle());
        let legend = self.series.len() > 1 || self.series.iter().any(|series| !series.label.is_empty());
        Some(html! {
            svg role="img" aria-label=(self.title) viewBox={ "0 0 " (WIDTH) " " (HEIGHT) } width=(WIDTH) height=(HEIGHT)
                font-size="11" font-family="system-ui,sans-serif" fill="currentColor"
            {
                (ticks(&x, &y))
                (self.frame())
                @for (series, colour) in coloured() { (self.series(series, colour, &x, &y)) }
                @if legend {
                    @for (index, (series, colour)) in coloured().enumerate() { (entry(index, &series.label, colour)) }
                }
            }
        })
    }

    /// Axes over all points; `None` when there is none.
    fn axes(&self) -> Option<(Axis, Axis)> {
        let all = || self.series.iter().flat_map(Series::finite);
        if self.diagonal {
            // One scale, so that the diagonal is where both are equal.
            let both = || all().flat_map(|point| [point.x, point.y]);
            return Axis::over(both()).zip(Axis::over(both()));
        }
        let heights = all().flat_map(|point| [point.y].into_iter().chain(point.interval.into_iter().flatten()));
        Axis::over(all().map(|point| point.x)).zip(Axis::over(heights))
    }

    /// The two axes with what they are, and the diagonal.
    fn frame(&self) -> Markup {
        let (middle_x, middle_y) = ((LEFT + RIGHT) / 2.0, (TOP + BOTTOM) / 2.0);
        html! {
            path d={ "M" (LEFT) " " (TOP) "V" (BOTTOM) "H" (RIGHT) } fill="none" stroke="currentColor" {}
            text x=(tenths(middle_x)) y=(tenths(HEIGHT - 8.0)) text-anchor="middle" { (self.x_label) }
            text transform={ "translate(13 " (tenths(middle_y)) ") rotate(-90)" } text-anchor="middle" { (self.y_label) }
            @if self.diagonal {
                path d={ "M" (LEFT) " " (BOTTOM) "L" (RIGHT) " " (TOP) } stroke="currentColor" stroke-opacity=".5"
                    stroke-dasharray="4 3" {}
            }
        }
    }

    /// The line and the points of one series.
    fn series(&self, series: &Series, colour: &str, x: &Axis, y: &Axis) -> Markup {
        let place = |point: &PlotPoint| (tenths(x.at(point.x, LEFT, RIGHT)), tenths(y.at(point.y, BOTTOM, TOP)));
        let path = || {
            let corners: Vec<String> = series.finite().map(place).map(|(x, y)| format!("{x} {y}")).collect();
            corners.join("L")
        };
        html! {
            @if self.lines { path d={ "M" (path()) } fill="none" stroke=(colour) stroke-width="1.6" {} }
            @for (point, [low, high]) in series.finite().filter_map(|point| Some((point, point.interval?))) {
                @let at = tenths(x.at(point.x, LEFT, RIGHT));
                path d={ "M" (at) " " (tenths(y.at(low, BOTTOM, TOP))) "V" (tenths(y.at(high, BOTTOM, TOP))) }
                    stroke=(colour) stroke-opacity=".5" stroke-width="2" {}
            }
            @if !self.bare {
                @for point in series.finite() {
                    @let (x, y) = place(point);
                    circle cx=(x) cy=(y) r="3.2" fill=(colour) fill-opacity=".8" {
                        title { (format!("{}: {:.4}, {:.4}", point.name, point.x, point.y)) }
                    }
                }
            }
        }
    }
}

impl Series {
    /// The points that have a place.
    fn finite(&self) -> impl Iterator<Item = &PlotPoint> {
        let points = self.points.iter();
        points.filter(|point| point.x.is_finite() && point.y.is_finite())
    }
}

/// Grid lines with their values.
fn ticks(x: &Axis, y: &Axis) -> Markup {
    html! {
        @for tick in x.ticks() {
            @let at = tenths(x.at(tick, LEFT, RIGHT));
            path d={ "M" (at) " " (TOP) "V" (BOTTOM) } stroke="currentColor" stroke-opacity=".15" {}
            text x=(at) y=(tenths(BOTTOM + 14.0)) text-anchor="middle" { (x.text(tick)) }
        }
        @for tick in y.ticks() {
            @let at = y.at(tick, BOTTOM, TOP);
            path d={ "M" (LEFT) " " (tenths(at)) "H" (RIGHT) } stroke="currentColor" stroke-opacity=".15" {}
            text x=(tenths(LEFT - 5.0)) y=(tenths(at + 4.0)) text-anchor="end" { (y.text(tick)) }
        }
    }
}

/// One line of the legend.
fn entry(index: usize, label: &str, colour: &str) -> Markup {
    let at = TOP + 12.0 + 14.0 * index as f64;
    html! {
        circle cx=(tenths(LEFT + 10.0)) cy=(tenths(at - 4.0)) r="3.2" fill=(colour) {}
        text x=(tenths(LEFT + 18.0)) y=(tenths(at)) { (label) }
    }
}

/// A coordinate, exact enough for a screen.
pub(crate) fn tenths(value: f64) -> String {
    format!("{value:.1}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f64, y: f64) -> PlotPoint {
        PlotPoint {
            x,
            y,
            name: "a<b".into(),
            interval: None,
        }
    }

    #[test]
    fn a_plot_draws_every_finite_point_and_escapes_names() {
        let plot = Plot {
            series: vec![Series {
                label: "x & y".into(),
                points: vec![point(1.0, 2.0), point(2.0, f64::NAN), point(3.0, 4.0)],
            }],
            lines: true,
            diagonal: true,
            ..Plot::default()
        };
        let text = |plot: &Plot| plot.figure().unwrap().into_string();
        let drawn = text(&plot);
        assert_eq!(drawn.matches("<title>").count(), 2);
        assert!(drawn.contains("x &amp; y") && drawn.contains("a&lt;b: 1.0000, 2.0000"));
        let bare = text(&Plot { bare: true, ..plot });
        assert!(!bare.contains("<title>") && bare.matches("stroke-width=\"1.6\"").count() == 1);
        assert!(Plot::default().figure().is_none());
    }

    #[test]
    fn intervals_are_bars_and_widen_the_axis() {
        let mut plot = Plot {
            series: vec![Series {
                label: String::new(),
                points: vec![point(1.0, 2.0), point(2.0, 3.0)],
            }],
            ..Plot::default()
        };
        let text = |plot: &Plot| plot.figure().unwrap().into_string();
        assert!(!text(&plot).contains("stroke-width=\"2\"") && !text(&plot).contains(">9<"));
        plot.series[0].points[0].interval = Some([1.0, 9.0]);
        let drawn = text(&plot);
        assert_eq!(drawn.matches("stroke-width=\"2\"").count(), 1);
        assert!(drawn.contains(">8<"), "{drawn}");
    }
}
