//! A linear axis with round ticks.

/// A linear axis.
pub(crate) struct Axis {
    low: f64,
    high: f64,
    step: f64,
}

impl Axis {
    /// An axis over the values with round ticks; `None` when there is no finite value.
    pub(crate) fn over(values: impl Iterator<Item = f64>) -> Option<Self> {
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

    /// Where ticks stand, ascending.
    pub(crate) fn ticks(&self) -> Vec<f64> {
        let first = (self.low / self.step).ceil() as i64;
        let last = (self.high / self.step).floor() as i64;
        (first..=last.min(first + 20)).map(|k| k as f64 * self.step).collect()
    }

    /// A tick with as many digits as its step needs; no negative zero.
    pub(crate) fn text(&self, value: f64) -> String {
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

    /// Where a value lies between the places of the ends of the axis, `from` and `to`.
    pub(crate) fn at(&self, value: f64, from: f64, to: f64) -> f64 {
        from + (value - self.low) / (self.high - self.low) * (to - from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
