//! Names that are safe as file names.

/// True for names that are safe as file names everywhere: `[A-Za-z0-9._+-]{1,128}`, not starting with `.` or `-`.
#[must_use]
pub fn is_safe_name(name: &str) -> bool {
    let allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"._+-".contains(&byte);
    (1..=128).contains(&name.len()) && name.bytes().all(allowed) && !name.starts_with(['.', '-'])
}

/// A safe name made from any text: other characters become `_`.
#[must_use]
pub fn safe_name(text: &str) -> String {
    let safe = |c: char| {
        if c.is_ascii_alphanumeric() || "._+-".contains(c) {
            c
        } else {
            '_'
        }
    };
    let mut name: String = text.chars().take(128).map(safe).collect();
    if name.is_empty() || name.starts_with(['.', '-']) {
        name.insert(0, '_');
        name.truncate(128);
    }
    name
}
