//! Files of a crate do not import each other in circles.
//!
//! A module's own children are part of it: a parent that uses its children, and children that use items their parent
//! defines, are no circle. A name that a parent re-exports stands for the file that defines it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Path of a module within its crate: empty for the root.
type Module = Vec<String>;

/// The modules of a crate with their sources, without test modules.
pub(crate) struct Crate {
    modules: BTreeMap<Module, String>,
}

impl Crate {
    /// Reads the modules below a `src` folder.
    pub(crate) fn read(src: &Path) -> Self {
        let mut modules = BTreeMap::new();
        read_folder(src, &mut Vec::new(), &mut modules);
        Self { modules }
    }

    /// The circles: every group of files that reach each other, largest first.
    pub(crate) fn circles(&self) -> Vec<Vec<String>> {
        let edges: BTreeMap<&Module, BTreeSet<Module>> = self
            .modules
            .iter()
            .map(|(module, source)| (module, self.imports(module, source)))
            .collect();
        let reach = |start: &Module| {
            let (mut seen, mut open) = (BTreeSet::new(), vec![start.clone()]);
            while let Some(module) = open.pop() {
                for next in edges.get(&module).into_iter().flatten() {
                    if seen.insert(next.clone()) {
                        open.push(next.clone());
                    }
                }
            }
            seen
        };
        let reached: BTreeMap<&Module, BTreeSet<Module>> =
            self.modules.keys().map(|module| (module, reach(module))).collect();
        let mut groups: BTreeSet<Vec<String>> = BTreeSet::new();
        for (module, reaches) in &reached {
            if reaches.contains(*module) {
                let group = reaches.iter().filter(|other| reached[other].contains(*module));
                groups.insert(group.map(|module| module.join("::")).collect());
            }
        }
        let mut groups: Vec<_> = groups.into_iter().collect();
        groups.sort_by_key(|group| std::cmp::Reverse(group.len()));
        groups
    }

    /// The files that a module imports from, without its ancestors and descendants.
    fn imports(&self, module: &Module, source: &str) -> BTreeSet<Module> {
        let paths = paths(source).into_iter();
        let absolute = paths.filter_map(|path| absolute(module, &path));
        absolute
            .map(|path| self.home(&path, 0))
            .filter(|target| !target.starts_with(module) && !module.starts_with(target))
            .collect()
    }

    /// The module that defines an item: the deepest one on its path, or where that one re-exports it from.
    fn home(&self, path: &[String], depth: usize) -> Module {
        let length = (0..=path.len())
            .rev()
            .find(|&length| self.modules.contains_key(&path[..length]))
            .unwrap_or_default();
        let module = path[..length].to_vec();
        let Some(item) = path.get(length).filter(|_| depth < 8) else {
            return module;
        };
        for statement in self.modules[&module].split(';') {
            let Some(at) = statement.find("pub use ").or_else(|| statement.find("pub(crate) use ")) else {
                continue;
            };
            for export in paths(&format!("{};", &statement[at..])) {
                if export.last() == Some(item)
                    && let Some(target) = absolute(&module, &export)
                    && target != path
                {
                    return self.home(&target, depth + 1);
                }
            }
        }
        module
    }
}

fn read_folder(folder: &Path, module: &mut Module, out: &mut BTreeMap<Module, String>) {
    let mut entries: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    entries.sort();
    for path in entries {
        let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            module.push(stem);
            read_folder(&path, module, out);
            module.pop();
        } else if path.extension().is_some_and(|extension| extension == "rs") && stem != "tests" && stem != "main" {
            let mut own = module.clone();
            if stem != "lib" && stem != "mod" {
                own.push(stem);
            }
            let text = std::fs::read_to_string(&path).unwrap();
            let code = text.split("#[cfg(test)]").next().unwrap();
            let code: Vec<&str> = code.lines().map(|line| line.split("//").next().unwrap()).collect();
            out.insert(own, code.join("\n"));
        }
    }
}

/// Every path that begins with `crate`, `self` or `super`, or stands in a `use`, with `{…}` spread out.
fn paths(source: &str) -> Vec<Vec<String>> {
    let mut out = Vec::new();
    let bytes = source.as_bytes();
    let is_word = |at: usize| {
        bytes
            .get(at)
            .is_some_and(|b| b.is_ascii_alphanumeric() || *b == b'_' || *b == b':')
    };
    for start in ["crate::", "self::", "super::", "use "] {
        for (at, _) in source.match_indices(start) {
            if at > 0 && is_word(at - 1) {
                continue;
            }
            let from = if start == "use " { at + 4 } else { at };
            spread(&source[from..], &mut Vec::new(), &mut out);
        }
    }
    out
}

/// Spreads the tree of a path at the beginning of a text out; returns what follows it.
fn spread<'a>(text: &'a str, prefix: &mut Vec<String>, out: &mut Vec<Vec<String>>) -> &'a str {
    let depth = prefix.len();
    let mut rest = text.trim_start();
    loop {
        if let Some(inside) = rest.strip_prefix('{') {
            rest = inside.trim_start();
            while !rest.is_empty() && !rest.starts_with('}') {
                let before = rest.len();
                rest = spread(rest, prefix, out).trim_start();
                rest = rest.strip_prefix(',').unwrap_or(rest).trim_start();
                if rest.len() == before {
                    break;
                }
            }
            rest = rest.strip_prefix('}').unwrap_or(rest);
            break;
        }
        let end = rest
            .find(|c: char| !c.is_ascii_alphanumeric() && c != '_')
            .unwrap_or(rest.len());
        let word = &rest[..end];
        rest = &rest[end..];
        if !word.is_empty() && word != "self" || prefix.is_empty() && !word.is_empty() {
            prefix.push(word.to_owned());
        }
        match rest.strip_prefix("::") {
            Some(more) => rest = more.trim_start(),
            None => {
                out.push(prefix.clone());
                if let Some(alias) = rest.trim_start().strip_prefix("as ") {
                    let end = alias
                        .find(|c: char| !c.is_ascii_alphanumeric() && c != '_')
                        .unwrap_or(alias.len());
                    rest = &alias[end..];
                }
                break;
            }
        }
    }
    prefix.truncate(depth);
    rest
}

/// A path from the root of the crate; `None` for one of another crate.
fn absolute(module: &[String], path: &[String]) -> Option<Vec<String>> {
    let mut base: Vec<String> = match path.first()?.as_str() {
        "crate" => Vec::new(),
        "self" => module.to_vec(),
        "super" => module.split_last()?.1.to_vec(),
        _ => [module, &path[..1]].concat(),
    };
    for word in &path[1..] {
        if word == "super" {
            base.pop();
        } else {
            base.push(word.clone());
        }
    }
    Some(base)
}

#[test]
fn a_circle_is_found_through_a_re_export() {
    let module = |path: &[&str]| path.iter().map(|&word| word.to_owned()).collect::<Module>();
    let modules = [
        (module(&[]), "mod a; mod b; pub use a::{First, Second as Other};"),
        (module(&["a"]), "use super::b::Third; pub struct First;"),
        (module(&["b"]), "fn f(first: &crate::First) {}"),
    ];
    let own = Crate {
        modules: modules.map(|(path, source)| (path, source.to_owned())).into(),
    };
    assert_eq!(own.circles(), [["a", "b"]]);
}
