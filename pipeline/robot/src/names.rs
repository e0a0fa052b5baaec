//! Names of links and joints: selection patterns.

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
}
