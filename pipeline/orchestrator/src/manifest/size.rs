//! Sizes as people write them.

/// Bytes of a size such as `12 GiB`, `800MB` or `1.5 GiB`.
///
/// # Errors
/// When it is not a size.
pub fn parse_size(text: &str) -> std::result::Result<u64, String> {
    let trimmed = text.trim();
    let digits = trimmed
        .find(|c: char| !c.is_ascii_digit() && c != '.')
        .unwrap_or(trimmed.len());
    let unit: f64 = match trimmed[digits..].trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        "tb" => 1e12,
        "k" | "kib" => 1024.0,
        "m" | "mib" => 1_048_576.0,
        "g" | "gib" => 1_073_741_824.0,
        "t" | "tib" => 1_099_511_627_776.0,
        _ => return Err(format!("invalid size `{text}`: expected e.g. `12 GiB`")),
    };
    let number: f64 = trimmed[..digits]
        .parse()
        .map_err(|_| format!("invalid size `{text}`: expected e.g. `12 GiB`"))?;
    Ok((number * unit) as u64)
}
