//! Plots as inline SVG: axes, points, lines, a legend. Colours of text and axes follow the page.

use std::fmt::Write as _;

use super::escape;

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
}

const WIDTH: f64 = 420.0;
const HEIGHT: f64 = 300.0;
/// Left, right, top, bottom.
const MARGIN: [f64; 4] = [58.0, 12.0, 10.0, 42.0];
/// Colours that people with colour-blindness can tell apart, on light and dark ground.
const COLOURS: [&str; 7] = [
    "#0f7fc4", "#d55e00", "#009e73", "#cc79a7", "#e0a400", "#56b4e9", "#8a6fd1",
];

/// A linear axis.
struct Axis {
    low: f64,
    high: f64,
    step: f64,
}

impl Axis {
    /// An axis over the values with round ticks; `None` when there is no finite value.
    fn over(values: impl Iterator<Item = f64>) -> Option<Self> {
        let finite = values.filter(|value| value.is_finite());
        let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
        if low > high {
            return None;
        }
        let pad = (0.06 * (high - low)).max(1e-3 * high.abs()).max(1e-9);
        let (low, high) = (low - pad, high + pad);
        let rough = (high - low) / 5.0;
        let power = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .into_iter()
            .map(|factor| factor * power)
            .find(|step| *step >= rough)
            .unwrap_or(rough);
        Some(Self { low, high, step })
    }

    fn ticks(&self) -> Vec<f64> {
        let first = (self.low / self.step).ceil() as i64;
        let last = (self.high / self.step).floor() as i64;
        (first..=last.min(first + 20)).map(|k| k as f64 * self.step).collect()
    }

    fn text(&self, value: f64) -> String {
        let digits = (-self.step.log10().floor()).clamp(0.0, 9.0) as usize;
        let text = format!("{value:.digits$}");
        if text
            .trim_start_matches('-')
            .bytes()
            .all(|byte| byte == b'0' || byte == b'.')
        {
            text.trim_start_matches('-').to_owned()
        } else {
            text
        }
    }

    fn at(&self, value: f64, from: f64, to: f64) -> f64 {
        from + (value - self.low) / (self.high - self.low) * (to - from)
    }
}

/// The plot as SVG; empty when there is no point.
#[must_use]
pub fn svg(plot: &Plot) -> String {
    let all = || plot.series.iter().flat_map(|series| &series.points);
    let finite = |point: &&PlotPoint| point.x.is_finite() && point.y.is_finite();
    let (mut x, mut y) = (
        Axis::over(all().filter(finite).map(|point| point.x)),
        Axis::over(all().filter(finite).map(|point| point.y)),
    );
    if plot.diagonal {
        // One scale, so that the diagonal is where both are equal.
        let both = || all().filter(finite).flat_map(|point| [point.x, point.y]);
        (x, y) = (Axis::over(both()), Axis::over(both()));
    }
    let (Some(x), Some(y)) = (x, y) else {
        return String::new();
    };
    let [left, right, top, bottom] = MARGIN;
    let (right, bottom) = (WIDTH - right, HEIGHT - bottom);
    let mut out = format!(
        "<svg role=\"img\" aria-label=\"{}\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" \
         font-size=\"11\" font-family=\"system-ui,sans-serif\" fill=\"currentColor\">\n",
        escape(&plot.title)
    );
    for tick in x.ticks() {
        let at = x.at(tick, left, right);
        let _ = writeln!(
            out,
            "<path d=\"M{at:.1} {top}V{bottom}\" stroke=\"currentColor\" stroke-opacity=\".15\"/>\
             <text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            bottom + 14.0,
            x.text(tick)
        );
    }
    for tick in y.ticks() {
        let at = y.at(tick, bottom, top);
        let _ = writeln!(
            out,
            "<path d=\"M{left} {at:.1}H{right}\" stroke=\"currentColor\" stroke-opacity=\".15\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            left - 5.0,
            at + 4.0,
            y.text(tick)
        );
    }
    let _ = writeln!(
        out,
        "<path d=\"M{left} {top}V{bottom}H{right}\" fill=\"none\" stroke=\"currentColor\"/>\
         <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\
         <text transform=\"translate(13 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        (left + right) / 2.0,
        HEIGHT - 8.0,
        escape(&plot.x_label),
        (top + bottom) / 2.0,
        escape(&plot.y_label)
    );
    if plot.diagonal {
        let _ = writeln!(
            out,
            "<path d=\"M{left} {bottom}L{right} {top}\" stroke=\"currentColor\" stroke-opacity=\".5\" stroke-dasharray=\"4 3\"/>"
        );
    }
    for (series, colour) in plot.series.iter().zip(COLOURS.iter().cycle()) {
        let points = || series.points.iter().filter(finite);
        let place = |point: &PlotPoint| (x.at(point.x, left, right), y.at(point.y, bottom, top));
        if plot.lines {
            let path: Vec<String> = points().map(place).map(|(x, y)| format!("{x:.1} {y:.1}")).collect();
            let _ = writeln!(
                out,
                "<path d=\"M{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.6\"/>",
                path.join("L")
            );
        }
        for point in points().filter(|_| !plot.bare) {
            let (x, y) = place(point);
            let _ = writeln!(
                out,
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.2\" fill=\"{colour}\" fill-opacity=\".8\"><title>{}: {:.4}, {:.4}</title></circle>",
                escape(&point.name),
                point.x,
                point.y
            );
        }
    }
    if plot.series.len() > 1 || plot.series.iter().any(|series| !series.label.is_empty()) {
        for (index, (series, colour)) in plot.series.iter().zip(COLOURS.iter().cycle()).enumerate() {
            let at = top + 12.0 + 14.0 * index as f64;
            let _ = writeln!(
                out,
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3.2\" fill=\"{colour}\"/><text x=\"{:.1}\" y=\"{at:.1}\">{}</text>",
                left + 10.0,
                at - 4.0,
                left + 18.0,
                escape(&series.label)
            );
        }
    }
    out.push_str("</svg>");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f64, y: f64) -> PlotPoint {
        PlotPoint {
            x,
            y,
            name: "a<b".into(),
        }
    }

    #[test]
    fn axes_have_round_ticks() {
        let axis = Axis::over([0.0, 4.0].into_iter()).unwrap();
        assert_eq!(axis.ticks(), [0.0, 1.0, 2.0, 3.0, 4.0]);
        assert_eq!((axis.text(0.0), axis.text(-0.0)), ("0".to_owned(), "0".to_owned()));
        let narrow = Axis::over([19.71, 19.72].into_iter()).unwrap();
        assert!(narrow.ticks().len() >= 4 && narrow.text(19.715).starts_with("19.71"));
        let one = Axis::over([7.0].into_iter()).unwrap();
        assert!(one.low < 7.0 && one.high > 7.0 && !one.ticks().is_empty());
        assert!(Axis::over([f64::NAN].into_iter()).is_none());
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
        let text = svg(&plot);
        assert_eq!(text.matches("<title>").count(), 2);
        assert!(text.contains("x &amp; y") && text.contains("a&lt;b: 1.0000, 2.0000"));
        assert!(text.starts_with("<svg") && text.ends_with("</svg>"));
        let bare = svg(&Plot { bare: true, ..plot });
        assert!(!bare.contains("<title>") && bare.matches("stroke-width=\"1.6\"").count() == 1);
        assert_eq!(svg(&Plot::default()), "");
    }
}
