//! Factors by which numbers of the wrong unit are off.

/// Ratios that mean a unit, the largest first, and what they mean when measured numbers are so many times too large.
const FACTORS: [(f64, &str); 6] = [
    (1000.0, "millimetres instead of metres"),
    (100.0, "centimetres instead of metres"),
    (180.0 / std::f64::consts::PI, "degrees instead of radians"),
    (1.0 / 0.0254, "inches instead of metres"),
    (10.0, "ten times the unit, as 10000 steps a metre read as millimetres"),
    (
        5.0,
        "five times the unit, as 5000 steps a metre (TUM) read as millimetres",
    ),
];

/// How far from a factor a ratio may lie.
const TOLERANCE: f64 = 0.08;

/// A factor that tells of a wrong unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnitFactor {
    /// The ratio that is meant, above or below 1.
    pub factor: f64,
    /// What it usually means.
    pub meaning: &'static str,
}

/// The usual mistake that a ratio of numbers to what they should be is near to (within 8 %), if any: 1000, 100, 57.3, 10,
/// 5 and their inverses.
#[must_use]
pub fn unit_factor(ratio: f64) -> Option<UnitFactor> {
    let near = |factor: f64| (ratio / factor - 1.0).abs() < TOLERANCE;
    FACTORS.iter().find_map(|&(factor, meaning)| {
        if near(factor) {
            Some(UnitFactor { factor, meaning })
        } else if near(1.0 / factor) {
            let meaning = match factor {
                1000.0 => "divided by 1000 once too often",
                100.0 => "divided by 100 once too often",
                39.0..40.0 => "converted from inches once too often",
                10.0 => "a tenth of the unit",
                5.0 => "a fifth of the unit",
                _ => "converted from degrees to radians once too often",
            };
            Some(UnitFactor {
                factor: 1.0 / factor,
                meaning,
            })
        } else {
            None
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn usual_factors_are_told_by_name() {
        for (ratio, words) in [
            (998.0, "millimetres"),
            (104.0, "centimetres"),
            (57.0, "degrees"),
            (39.4, "inches"),
            (9.8, "10000"),
            (5.1, "5000"),
            (0.001, "1000 once too often"),
            (0.2, "a fifth"),
            (0.0175, "degrees to radians once"),
        ] {
            assert!(
                unit_factor(ratio).is_some_and(|found| found.meaning.contains(words)),
                "{ratio}"
            );
        }
        for ratio in [1.0, 0.9, 2.0, 7.0, 30.0, 300.0, 0.0, -5.0, f64::NAN, f64::INFINITY] {
            assert_eq!(unit_factor(ratio), None, "{ratio}");
        }
    }
}
