//! Names of links and joints: selection patterns and suggestions for misspelt names.

/// True when `name` matches `pattern`: an exact name, or a name with one leading or one trailing `*`.
#[must_use]
pub fn matches_pattern(pattern: &str, name: &str) -> bool {
    if let Some(start) = pattern.strip_suffix('*') {
        name.starts_with(start)
    } else if let Some(end) = pattern.strip_prefix('*') {
        name.ends_with(end)
    } else {
        name == pattern
    }
}

/// True when any of the patterns matches.
#[must_use]
pub fn matches_any(patterns: &[String], name: &str) -> bool {
    patterns.iter().any(|pattern| matches_pattern(pattern, name))
}

/// `; did you mean ...?` with the nearest of the known names, or all names when there are few, or nothing.
#[must_use]
pub fn suggestion<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> String {
    let known: Vec<&str> = known.collect();
    let lowered = name.to_lowercase();
    let score = |candidate: &str| strsim::jaro_winkler(&lowered, &candidate.to_lowercase());
    let best = known
        .iter()
        .map(|candidate| (score(candidate), *candidate))
        .max_by(|a, b| a.0.total_cmp(&b.0));
    match best {
        Some((score, candidate)) if score > 0.8 => format!("; did you mean `{candidate}`?"),
        _ if !known.is_empty() && known.len() <= 16 => format!("; it has {}", known.join(", ")),
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_match_at_one_end_only() {
        assert!(matches_pattern("panda_link*", "panda_link3"));
        assert!(matches_pattern("*_sc", "panda_link3_sc"));
        assert!(!matches_pattern("*_sc", "panda_link3"));
        assert!(matches_pattern("camera", "camera"));
        assert!(!matches_pattern("camera", "camera_mount"));
    }

    #[test]
    fn a_misspelt_name_gets_its_neighbour() {
        let known = ["panda_link0", "panda_link8", "robotiq_85_base_link"];
        assert!(suggestion("robotiq_base_link", known.into_iter()).contains("`robotiq_85_base_link`"));
        assert_eq!(
            suggestion("zzz", known.into_iter()),
            "; it has panda_link0, panda_link8, robotiq_85_base_link"
        );
    }
}
