//! The text files of the repository: pages with their headings, and what is said of pages.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

/// Folders that programs fill, wherever they lie.
const MADE: [&str; 2] = ["target", "node_modules"];
/// Folders of the repository that hold text of ours.
pub(crate) const FOLDERS: [&str; 8] = [
    ".ci",
    "docs",
    "manifests",
    "pipeline",
    "schemas",
    "stages",
    "tests",
    "tools",
];
/// Endings of files in which pages are named.
const ENDINGS: [&str; 7] = ["md", "rs", "toml", "py", "sh", "wgsl", "yml"];

/// The root of the repository.
pub(crate) fn root() -> PathBuf {
    let crate_folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    crate_folder.ancestors().nth(2).unwrap().to_path_buf()
}

/// A text file of the repository.
pub(crate) struct File {
    /// Relative to the root.
    pub(crate) path: PathBuf,
    pub(crate) text: String,
}

impl File {
    pub(crate) fn folder(&self) -> &Path {
        self.path.parent().unwrap()
    }

    pub(crate) fn is_page(&self) -> bool {
        self.path.extension().is_some_and(|ending| ending == "md")
    }
}

/// All text files, ordered by path.
pub(crate) fn files() -> Vec<File> {
    fn walk(root: &Path, folder: &Path, deep: bool, out: &mut Vec<File>) {
        for entry in std::fs::read_dir(root.join(folder)).unwrap() {
            let entry = entry.unwrap();
            let path = folder.join(entry.file_name());
            let kind = entry.file_type().unwrap();
            if kind.is_dir() && deep && !MADE.iter().any(|made| entry.file_name() == *made) {
                walk(root, &path, true, out);
            }
            let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
            if kind.is_file() && ENDINGS.contains(&ending) {
                let text = std::fs::read_to_string(root.join(&path)).unwrap();
                out.push(File { path, text });
            }
        }
    }
    let mut out = Vec::new();
    walk(&root(), Path::new(""), false, &mut out);
    for folder in FOLDERS {
        walk(&root(), Path::new(folder), true, &mut out);
    }
    out.sort_by(|a, b| a.path.cmp(&b.path));
    out
}

/// `folder/relative` without `.` and `..`; `None` when it leaves the repository.
pub(crate) fn joined(folder: &Path, relative: &str) -> Option<PathBuf> {
    let mut out = PathBuf::new();
    for part in folder.join(relative).components() {
        let inside = match part {
            Component::Normal(name) => {
                out.push(name);
                true
            }
            Component::ParentDir => out.pop(),
            _ => true,
        };
        if !inside {
            return None;
        }
    }
    Some(out)
}

/// A page with its headings.
pub(crate) struct Page {
    /// As GitHub makes them.
    pub(crate) anchors: BTreeSet<String>,
    /// First words of the headings: `7`, `B.4`, `appendix`.
    pub(crate) sections: BTreeSet<String>,
}

/// Lines outside of code blocks, with their numbers.
pub(crate) fn prose(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut code = false;
    text.lines().enumerate().filter_map(move |(index, line)| {
        let fence = line.trim_start().starts_with("```");
        code ^= fence;
        (!code && !fence).then_some((index + 1, line))
    })
}

impl Page {
    pub(crate) fn new(text: &str) -> Self {
        let (mut anchors, mut sections) = (BTreeSet::new(), BTreeSet::new());
        for (_, line) in prose(text).filter(|(_, line)| line.starts_with('#')) {
            let heading = line.trim_start_matches('#').trim();
            let kept = |c: &char| c.is_alphanumeric() || [' ', '-', '_'].contains(c);
            let slug: String = heading.chars().filter(kept).collect();
            let slug = slug.to_lowercase().replace(' ', "-");
            let mut anchor = slug.clone();
            for count in 1.. {
                if anchors.insert(anchor) {
                    break;
                }
                anchor = format!("{slug}-{count}");
            }
            let first = heading.split(' ').next().unwrap_or_default();
            sections.insert(first.trim_end_matches(['.', ':']).to_lowercase());
        }
        Self { anchors, sections }
    }
}

/// Every page by its path.
pub(crate) fn pages(files: &[File]) -> BTreeMap<PathBuf, Page> {
    let pages = files.iter().filter(|file| file.is_page());
    pages.map(|file| (file.path.clone(), Page::new(&file.text))).collect()
}

/// Text in one line: comment marks and line ends are spaces, so that a citation may be broken.
pub(crate) fn flat(file: &File) -> String {
    let plain = |line: &str| {
        let line = line.trim();
        let marks = ["//!", "///", "//", "#"];
        let mark = marks.iter().find(|mark| !file.is_page() && line.starts_with(**mark));
        line[mark.map_or(0, |mark| mark.len())..].trim().to_owned()
    };
    file.text.lines().map(plain).collect::<Vec<_>>().join(" ")
}

/// A page named in a text: the name as written, and what follows it.
pub(crate) fn mentions(text: &str) -> Vec<(&str, &str)> {
    let in_name = |c: char| c.is_ascii_alphanumeric() || "_./-".contains(c);
    let mention = |(at, _): (usize, &str)| {
        let end = at + ".md".len();
        let goes_on = text[end..]
            .chars()
            .next()
            .is_some_and(|c| c.is_alphanumeric() || c == '_');
        let start = text[..at].rfind(|c| !in_name(c)).map_or(0, |before| {
            before + text[before..].chars().next().map_or(1, char::len_utf8)
        });
        let name = &text[start..end];
        let placeholder = text[..start].ends_with(['*', '}', '>', '$']);
        let is_name = !goes_on && !placeholder && !name.starts_with("//") && !name.ends_with("/.md") && name != ".md";
        is_name.then_some((name, &text[end..]))
    };
    text.match_indices(".md").filter_map(mention).collect()
}

/// The page that a name means: from the root, or from a folder above the file. In the words of a link it is the page that
/// the link leads to.
pub(crate) fn meant<'a>(pages: &'a BTreeMap<PathBuf, Page>, file: &File, name: &str, behind: &str) -> Option<&'a Page> {
    let words = behind
        .split_once("](")
        .filter(|(words, _)| file.is_page() && !words.contains(['[', '(']));
    let name = words.map_or(name, |(_, target)| target.split([')', '#']).next().unwrap_or_default());
    let folders = [Path::new("")].into_iter().chain(file.folder().ancestors());
    let paths = folders.filter_map(|folder| joined(folder, name));
    paths.into_iter().find_map(|path| pages.get(&path))
}

/// A section number at the beginning of a text (`7`, `9.3`, `B.4`, and `B` where a letter may stand alone).
fn section(text: &str, letter_alone: bool) -> Option<(&str, &str)> {
    let (mut end, mut digits) = (0, false);
    let bytes = text.as_bytes();
    if bytes.first().is_some_and(|byte| (b'A'..=b'E').contains(byte)) {
        end = 1;
    }
    loop {
        let dot = usize::from(end > 0);
        let number = text
            .get(end + dot..)
            .unwrap_or_default()
            .bytes()
            .take_while(u8::is_ascii_digit)
            .count();
        if number == 0 || (dot == 1 && bytes[end] != b'.') {
            break;
        }
        (end, digits) = (end + dot + number, true);
    }
    let ends = !text[end..].chars().next().is_some_and(char::is_alphanumeric);
    (end > 0 && ends && (digits || letter_alone)).then(|| text.split_at(end))
}

/// The sections that a text cites right behind the name of a page.
pub(crate) fn cited(behind: &str) -> Vec<String> {
    let text = behind.trim_start_matches(['`', ')', ']', '"', '*']);
    let text = text.strip_prefix(',').unwrap_or(text).trim_start();
    let words = ["sections ", "section ", "part "];
    if text.starts_with("appendix") {
        return vec!["appendix".into()];
    }
    let word = words.iter().find(|word| text.starts_with(**word));
    let mut rest = &text[word.map_or(0, |word| word.len())..];
    let mut found = Vec::new();
    if word.is_none() && !rest.starts_with(|c: char| c.is_ascii_uppercase()) {
        return found;
    }
    while let Some((number, behind)) = section(rest, word.is_some()) {
        found.push(number.to_lowercase());
        let joints = [", and ", ", ", " and ", " to ", " or "];
        let Some(joint) = joints.iter().find(|joint| behind.starts_with(**joint)) else {
            break;
        };
        rest = &behind[joint.len()..];
    }
    found
}
