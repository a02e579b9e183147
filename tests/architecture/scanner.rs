//! What Rust source text uses: paths, without a parser.
//!
//! Reads `crate::…` and `super::…` paths, nested braces included, outside comments, strings and
//! `#[cfg(test)]` items. Assumes formatted code in which modules live in files; deliberately does
//! not expand macros. Re-exports of a façade are followed one step: `crate::grid::Tree` is a use of
//! `grid/tree`.

use std::collections::{BTreeMap, BTreeSet};

/// Blanks comments and the contents of string and character literals; line breaks stay.
fn without_comments_and_strings(text: &str) -> String {
    let c: Vec<char> = text.chars().collect();
    let mut out = String::with_capacity(text.len());
    let mut i = 0;
    let at = |i: usize| c.get(i).copied().unwrap_or('\0');
    while i < c.len() {
        let end = match (at(i), at(i + 1)) {
            ('/', '/') => (i..c.len()).find(|&k| c[k] == '\n').unwrap_or(c.len()),
            ('/', '*') => {
                let (mut depth, mut k) = (1, i + 2);
                while depth > 0 && k < c.len() {
                    match (at(k), at(k + 1)) {
                        ('/', '*') => (depth, k) = (depth + 1, k + 1),
                        ('*', '/') => (depth, k) = (depth - 1, k + 1),
                        _ => {}
                    }
                    k += 1;
                }
                k
            }
            ('r', '"' | '#') if i == 0 || !(at(i - 1).is_alphanumeric() || at(i - 1) == '_') => {
                let hashes = (i + 1..c.len()).take_while(|&k| c[k] == '#').count();
                if at(i + 1 + hashes) == '"' {
                    let closes = |&k: &usize| c[k] == '"' && (1..=hashes).all(|h| at(k + h) == '#');
                    let close = (i + 2 + hashes..c.len()).find(closes).unwrap_or(c.len());
                    close + 1 + hashes
                } else {
                    i
                }
            }
            ('"', _) => {
                let mut k = i + 1;
                while k < c.len() && c[k] != '"' {
                    k += if c[k] == '\\' { 2 } else { 1 };
                }
                k + 1
            }
            // A character, not a lifetime: 'x' or an escape.
            ('\'', '\\') => (i + 3..c.len()).find(|&k| c[k] == '\'').unwrap_or(i) + 1,
            ('\'', _) if at(i + 2) == '\'' => i + 3,
            _ => i,
        };
        if end > i {
            let end = end.min(c.len());
            out.extend(
                c[i..end]
                    .iter()
                    .map(|&x| if x == '\n' { '\n' } else { ' ' }),
            );
            i = end;
        } else {
            out.push(c[i]);
            i += 1;
        }
    }
    out
}

/// Blanks the items under `#[cfg(test)]`, braces and all.
fn without_tests(code: &str) -> String {
    const MARK: &str = "#[cfg(test)]";
    let mut out = code.to_owned();
    while let Some(start) = out.find(MARK) {
        let rest = &out[start + MARK.len()..];
        let open = rest.find(['{', ';']).unwrap_or(rest.len());
        let mut depth = 0;
        let mut length = rest.len();
        for (k, x) in rest.char_indices().skip_while(|(k, _)| *k < open) {
            match x {
                '{' => depth += 1,
                '}' => depth -= 1,
                _ => {}
            }
            if depth == 0 {
                length = k + x.len_utf8();
                break;
            }
        }
        let end = start + MARK.len() + length;
        let blank: String = out[start..end]
            .chars()
            .map(|x| if x == '\n' { '\n' } else { ' ' })
            .collect();
        out.replace_range(start..end, &blank);
    }
    out
}

/// Returns the text without comments, literals and tests.
pub(super) fn production_code(text: &str) -> String {
    without_tests(&without_comments_and_strings(text))
}

/// Returns the paths of the use tree at the start of `text`: `a::{b::C, d}` gives two.
fn expand_use_tree(text: &str) -> Vec<Vec<String>> {
    let mut paths = Vec::new();
    let mut prefixes: Vec<Vec<String>> = Vec::new();
    let mut path: Vec<String> = Vec::new();
    let mut name = String::new();
    // A blank closes a path that the end of the text would leave open.
    for x in text.chars().chain([' ']) {
        if x.is_alphanumeric() || x == '_' {
            name.push(x);
            continue;
        }
        if !name.is_empty() {
            path.push(std::mem::take(&mut name));
        }
        if x == '{' {
            prefixes.push(path.clone());
        } else if let (',' | '}', Some(prefix)) = (x, prefixes.last()) {
            if path.len() > prefix.len() {
                paths.push(std::mem::replace(&mut path, prefix.clone()));
            }
            if x == '}' {
                prefixes.pop();
                path = prefixes.last().cloned().unwrap_or_default();
            }
        }
        if prefixes.is_empty() && x != ':' {
            break;
        }
    }
    if !path.is_empty() {
        paths.push(path);
    }
    paths
}

/// The modules of the crate, and the items that façades re-export from them.
#[derive(Default)]
pub(super) struct Modules {
    known: BTreeSet<String>,
    /// `grid/Tree` → `grid/tree`.
    reexports: BTreeMap<String, String>,
}

impl Modules {
    /// Takes the name and text of every module.
    pub(super) fn new<'a>(sources: impl Iterator<Item = (&'a str, &'a str)> + Clone) -> Self {
        let known = sources
            .clone()
            .map(|(module, _)| module.to_owned())
            .collect();
        let mut modules = Self {
            known,
            reexports: BTreeMap::new(),
        };
        for (facade, text) in sources {
            let code = production_code(text);
            for (start, mark) in code.match_indices("pub use ") {
                for path in expand_use_tree(&code[start + mark.len()..]) {
                    let target = modules.resolve(&[vec![facade.to_owned()], path.clone()].concat());
                    let item = path.last().map_or("", String::as_str);
                    modules.reexports.insert(format!("{facade}/{item}"), target);
                }
            }
        }
        modules
    }

    /// Returns the module that a path from the crate's root leads to; `lib` if to none.
    fn resolve(&self, path: &[String]) -> String {
        let prefix = |n: usize| path[..n].join("/");
        let reexport = (1..=path.len()).find_map(|n| self.reexports.get(&prefix(n)));
        let longest = || {
            (1..=path.len())
                .rev()
                .map(prefix)
                .find(|m| self.known.contains(m))
        };
        reexport
            .cloned()
            .or_else(longest)
            .unwrap_or_else(|| "lib".to_owned())
    }

    /// Returns what the text of `module` uses: line number and module.
    pub(super) fn used_by(&self, module: &str, text: &str) -> Vec<(usize, String)> {
        let code = production_code(text);
        let mut used = Vec::new();
        for word in ["crate::", "super::"] {
            for (start, _) in code.match_indices(word) {
                let before = code[..start].chars().next_back();
                if before.is_some_and(|x| x.is_alphanumeric() || x == '_' || x == ':') {
                    continue; // the second of `super::super::`, climbed with the first
                }
                let line = code[..start].matches('\n').count() + 1;
                let mut base: Vec<String> = module.split('/').map(str::to_owned).collect();
                let mut rest = &code[start..];
                if let Some(r) = rest.strip_prefix("crate::") {
                    base.clear();
                    rest = r;
                }
                while let Some(r) = rest.strip_prefix("super::") {
                    base.pop();
                    rest = r;
                }
                for path in expand_use_tree(rest) {
                    used.push((line, self.resolve(&[base.clone(), path].concat())));
                }
            }
        }
        used.sort();
        used.dedup();
        used
    }
}
