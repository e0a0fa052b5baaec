//! What code and pages say of each other: named pages, cited sections, links, and the names in `docs/equations.md` exist.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod keys;
mod text;

use std::path::Path;

use text::{FOLDERS, File, Page, cited, files, flat, joined, meant, mentions, pages, prose, root};

/// Widest line of prose.
const WIDTH: usize = 120;

fn assert_none(wrong: &[String], what: &str) {
    assert!(wrong.is_empty(), "{what}:\n{}", wrong.join("\n"));
}

#[test]
fn named_pages_and_cited_sections_exist() {
    let files = files();
    let pages = pages(&files);
    let (mut wrong, mut sections) = (Vec::new(), 0);
    for file in files.iter().filter(|file| !file.path.starts_with("tests/documents")) {
        let text = flat(file);
        for (name, behind) in mentions(&text) {
            let Some(page) = meant(&pages, file, name, behind) else {
                wrong.push(format!("{}: there is no `{name}`", file.path.display()));
                continue;
            };
            if let Some(anchor) = behind.strip_prefix('#') {
                let end = anchor.find(|c: char| !(c.is_alphanumeric() || c == '-' || c == '_'));
                let anchor = &anchor[..end.unwrap_or(anchor.len())];
                if !page.anchors.contains(anchor) {
                    wrong.push(format!("{}: `{name}` has no `#{anchor}`", file.path.display()));
                }
            }
            for number in cited(behind) {
                sections += 1;
                if !page.sections.contains(&number) {
                    wrong.push(format!("{}: `{name}` has no section {number}", file.path.display()));
                }
            }
        }
    }
    assert_none(&wrong, "pages or sections that do not exist");
    assert!(sections > 100, "citations are not found any more: {sections}");
}

/// Targets of the links and pictures of a page, with their lines.
fn links(text: &str) -> Vec<(usize, String)> {
    let mut out = Vec::new();
    for (number, line) in prose(text) {
        // What is between backquotes is code.
        let spoken: String = line.split('`').step_by(2).collect::<Vec<_>>().join("x");
        for (at, _) in spoken.match_indices("](") {
            let target = &spoken[at + 2..];
            out.push((number, target[..target.find(')').unwrap_or(target.len())].to_owned()));
        }
        for attribute in ["src=\"", "href=\""] {
            for (at, _) in spoken.match_indices(attribute) {
                let target = spoken[at + attribute.len()..].split('"').next().unwrap_or_default();
                out.push((number, target.to_owned()));
            }
        }
    }
    out
}

#[test]
fn links_lead_somewhere() {
    let files = files();
    let pages = pages(&files);
    let mut wrong = Vec::new();
    for file in files.iter().filter(|file| file.is_page()) {
        for (line, target) in links(&file.text) {
            if target.contains("://") || target.starts_with("mailto:") {
                continue;
            }
            let (path, anchor) = target.split_once('#').unwrap_or((&target, ""));
            let place = match path {
                "" => Some(file.path.clone()),
                path => joined(file.folder(), path),
            };
            let place = place.filter(|place| root().join(place).exists());
            let known = place.as_ref().is_some_and(|place| {
                anchor.is_empty() || pages.get(place).is_some_and(|page| page.anchors.contains(anchor))
            });
            if !known {
                wrong.push(format!("{}:{line}: `{target}`", file.path.display()));
            }
        }
    }
    assert_none(&wrong, "links that lead nowhere");
}

#[test]
fn files_that_pages_name_exist() {
    let mut wrong = Vec::new();
    for file in files().iter().filter(|file| file.is_page()) {
        for (number, line) in prose(&file.text) {
            for name in line.split('`').skip(1).step_by(2) {
                let path = Path::new(name);
                let ending = path.extension().and_then(|ending| ending.to_str());
                let is_ours = FOLDERS.iter().any(|folder| path.starts_with(folder)) && !name.contains(['*', '{', ' ']);
                if is_ours && matches!(ending, Some("rs" | "toml" | "py" | "json")) && !root().join(path).exists() {
                    wrong.push(format!("{}:{number}: `{name}`", file.path.display()));
                }
            }
        }
    }
    assert_none(&wrong, "files that do not exist");
}

/// What a page shows after `cargo bench`, `run`, `test`, `build` or `check`, with the line.
fn cargo_commands(text: &str) -> Vec<(usize, &str)> {
    let mut out = Vec::new();
    for (number, line) in text.lines().enumerate() {
        for (at, word) in line.match_indices("cargo ") {
            let command = &line[at + word.len()..];
            let end = command.find(['`', '#']).unwrap_or(command.len());
            out.push((number + 1, &command[..end]));
        }
    }
    out
}

#[test]
fn cargo_commands_of_pages_name_what_exists() {
    let files = files();
    let crates: Vec<(&Path, &str)> = files
        .iter()
        .filter(|file| file.path.ends_with("Cargo.toml"))
        .filter_map(|file| {
            let name = file.text.lines().find_map(|line| line.strip_prefix("name = \""))?;
            Some((file.folder(), name.trim_end_matches('"')))
        })
        .collect();
    let (mut wrong, mut named) = (Vec::new(), 0);
    for file in files.iter().filter(|file| file.is_page()) {
        for (line, command) in cargo_commands(&file.text) {
            let mut places: Vec<&Path> = Vec::new();
            let words: Vec<&str> = command.split_whitespace().take_while(|word| *word != "--").collect();
            for pair in words.windows(2) {
                let [option, name] = [pair[0], pair[1]];
                let known = match option {
                    "-p" => {
                        named += 1;
                        places.extend(crates.iter().filter(|(_, own)| *own == name).map(|(folder, _)| *folder));
                        crates.iter().any(|(_, own)| *own == name)
                    }
                    "--bench" | "--example" | "--test" => {
                        let kind = if option == "--bench" { "benches" } else { "examples" };
                        let kind = if option == "--test" { "tests" } else { kind };
                        let inside = |folder: &Path| {
                            let folder = folder.join(kind);
                            let target = [folder.join(format!("{name}.rs")), folder.join(name).join("main.rs")];
                            target.iter().any(|path| root().join(path).exists())
                        };
                        // Tests of the whole workspace lie in the root's folder `tests`.
                        inside(Path::new("")) || places.iter().any(|folder| inside(folder))
                    }
                    _ => true,
                };
                if !known {
                    wrong.push(format!("{}:{line}: `{option} {name}`", file.path.display()));
                }
            }
        }
    }
    assert_none(&wrong, "crates, benches, examples or tests that do not exist");
    assert!(named > 15, "commands are not found any more: {named}");
}

/// Whether a file of Rust defines a name: a function, a type or a constant; a test, where one is asked for.
fn defines(text: &str, name: &str, test: bool) -> bool {
    let lines: Vec<&str> = text.lines().collect();
    let begins = |line: &str| {
        let found = |word: &str| {
            line.match_indices(&format!("{word} {name}")).any(|(at, all)| {
                let before = line[..at].chars().next_back();
                let after = line[at + all.len()..].chars().next();
                let word = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
                !word(before) && !word(after)
            })
        };
        ["fn", "struct", "enum", "trait", "impl", "const", "type"]
            .iter()
            .any(|word| found(word))
    };
    let is_test = |index: usize| {
        let above = lines[..index].iter().rev().map(|line| line.trim());
        above
            .take_while(|line| line.starts_with('#') || line.starts_with("//"))
            .any(|line| line.starts_with("#[test"))
    };
    let is_comment = |line: &str| line.trim_start().starts_with("//");
    let mut numbered = lines.iter().enumerate();
    numbered.any(|(index, line)| !is_comment(line) && begins(line) && (!test || is_test(index)))
}

/// Whether some source defines `module::Type::name`: every module is a part of its path, every type is defined there.
fn is_in_the_sources(sources: &[&File], name: &str, test: bool) -> bool {
    let mut parts: Vec<&str> = name.split("::").collect();
    let last = parts.pop().unwrap_or_default();
    sources.iter().any(|file| {
        let path = file.path.with_extension("");
        let folders: Vec<String> = path
            .iter()
            .map(|part| part.to_string_lossy().replace('-', "_"))
            .collect();
        let known = |part: &&str| {
            let is_module = folders.iter().any(|folder| folder == part);
            is_module || (part.starts_with(char::is_uppercase) && defines(&file.text, part, false))
        };
        file.text.contains(last) && parts.iter().all(known) && defines(&file.text, last, test)
    })
}

#[test]
fn functions_and_tests_of_the_paper_s_equations_exist() {
    let files = files();
    let page = files
        .iter()
        .find(|file| file.path.ends_with("docs/equations.md"))
        .unwrap();
    let is_source = |file: &&File| file.path.extension().is_some_and(|ending| ending == "rs");
    let sources: Vec<&File> = files.iter().filter(is_source).collect();
    let (mut wrong, mut names) = (Vec::new(), 0);
    for (line, row) in prose(&page.text).filter(|(_, line)| line.starts_with("| ")) {
        let cells: Vec<&str> = row.trim_matches('|').split('|').collect();
        for (column, test) in [(1, false), (2, true)] {
            let cell = cells.get(column).copied().unwrap_or_default();
            for name in cell.split('`').skip(1).step_by(2) {
                names += 1;
                if !is_in_the_sources(&sources, name, test) {
                    wrong.push(format!("{}:{line}: {name}", page.path.display()));
                }
            }
        }
    }
    assert_none(&wrong, "functions or tests that do not exist");
    assert!(names > 150, "names are not found any more: {names}");
}

#[test]
fn names_of_code_in_the_specification_exist() {
    let files = files();
    let is_source = |file: &&File| file.path.extension().is_some_and(|ending| ending == "rs");
    let sources: Vec<&File> = files.iter().filter(is_source).collect();
    let is_module = |name: &str| {
        let has = |file: &&File, part: &str| {
            let path = file.path.with_extension("");
            path.iter()
                .any(|folder| folder.to_string_lossy().replace('-', "_") == part)
        };
        sources.iter().any(|file| name.split("::").all(|part| has(file, part)))
    };
    let mut wrong = Vec::new();
    for file in files.iter().filter(|file| file.path.starts_with("docs/spec")) {
        for (number, line) in prose(&file.text) {
            for name in line.split('`').skip(1).step_by(2).filter(|name| name.contains("::")) {
                let plain = name.strip_prefix("rogs_").unwrap_or(name);
                if !is_module(plain) && !is_in_the_sources(&sources, plain, false) {
                    wrong.push(format!("{}:{number}: {name}", file.path.display()));
                }
            }
        }
    }
    assert_none(&wrong, "names that do not exist");
}

/// Lines of prose that are too wide: neither wrapped nor, in their paragraph, one sentence each.
fn wide_lines(text: &str) -> Vec<usize> {
    let is_free = |line: &str| line.starts_with(['|', '#', '<']) || line.starts_with("![") || line.starts_with("    ");
    let width = |line: &str| {
        // The target of a link cannot be broken.
        let parts = line.split("](").enumerate();
        let spoken = parts.map(|(index, part)| match (index, part.split_once(')')) {
            (1.., Some((_, rest))) => rest.chars().count() + 1,
            _ => part.chars().count(),
        });
        spoken.sum::<usize>()
    };
    let mut wide = Vec::new();
    let mut paragraph: Vec<(usize, &str)> = Vec::new();
    let mut close = |paragraph: &mut Vec<(usize, &str)>| {
        let ends = |line: &str| {
            line.trim_end_matches(['*', '_', '`', ')', '"'])
                .ends_with(['.', ':', '!', '?'])
        };
        if !paragraph.iter().all(|(_, line)| ends(line)) {
            wide.extend(
                paragraph
                    .iter()
                    .filter(|(_, line)| width(line) > WIDTH)
                    .map(|(number, _)| *number),
            );
        }
        paragraph.clear();
    };
    for (number, line) in prose(text) {
        if line.trim().is_empty() || is_free(line) {
            close(&mut paragraph);
        } else {
            paragraph.push((number, line));
        }
    }
    close(&mut paragraph);
    wide
}

#[test]
fn prose_is_wrapped() {
    let mut wrong = Vec::new();
    for file in files().iter().filter(|file| file.is_page()) {
        let lines = wide_lines(&file.text).into_iter();
        wrong.extend(lines.map(|line| format!("{}:{line}", file.path.display())));
    }
    assert_none(&wrong, "lines wider than 120 columns");
}

/// Words that the field does not use, with those that it does.
const WORDS: [(&str, &str); 6] = [
    ("graphics processor", "GPU"),
    ("minimal filtering", "Winograd"),
    ("comes with the program", "bundled"),
    ("come with the program", "bundled"),
    ("` is no ", "invalid … `x`: expected …"),
    ("}` is no ", "invalid … `{x}`: expected …"),
];

#[test]
fn words_are_those_of_the_field() {
    let mut wrong = Vec::new();
    for file in files().iter().filter(|file| !file.path.starts_with("tests/documents")) {
        for (number, line) in file.text.lines().enumerate() {
            for (word, better) in WORDS.iter().filter(|(word, _)| line.contains(word)) {
                wrong.push(format!(
                    "{}:{}: `{word}`: say {better}",
                    file.path.display(),
                    number + 1
                ));
            }
        }
    }
    assert_none(&wrong, "words that have better ones");
}

#[test]
fn citations_are_read_as_people_write_them() {
    let sections = |text: &str| cited(text).join(" ");
    assert_eq!(sections("` section 7)."), "7");
    assert_eq!(sections("` sections 9.3 to 9.5"), "9.3 9.5");
    assert_eq!(sections("` sections A.7 and A.9)."), "a.7 a.9");
    assert_eq!(sections("`, part B)."), "b");
    assert_eq!(sections("` A.4)."), "a.4");
    assert_eq!(sections(" section 10](rasteriser.md#10-contribution-sums)"), "10");
    assert_eq!(sections("` A field keeps"), "");
    assert_eq!(sections("` has them"), "");
    let found = mentions("see docs/a.md, `b.md` and https://x.org/c.md, not docs/*.md");
    let names: Vec<&str> = found.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["docs/a.md", "b.md"]);
    let page = Page::new("# T\n## 5.5 `rogs.x`: the y\n```\n# no\n```\n## T");
    let anchors: Vec<&str> = page.anchors.iter().map(String::as_str).collect();
    assert_eq!(anchors, ["55-rogsx-the-y", "t", "t-1"]);
    let wide = format!("{}\nshort line that goes on\n", "word ".repeat(30));
    assert_eq!(wide_lines(&wide), [1]);
    assert!(wide_lines(&format!("{}.\n", "word ".repeat(30))).is_empty());
}
