//! The dependency table of docs/architecture.md, enforced on the text of `src/**/*.rs`.
//!
//! A row of [`TABLE`] names a module (a file, or a folder with everything in it) and the modules
//! it may use; the most specific row counts. Rows stand in order: a row may only name rows above
//! it and itself, so the table has no cycles. Tests may use anything.

#[path = "architecture/scanner.rs"]
mod scanner;

use std::fmt::Write as _;
use std::path::Path;

use scanner::{Modules, production_code};

/// Module, and what it may use. Changing this table takes a page in docs/adr.
const TABLE: &[(&str, &str)] = &[
    ("space", ""),
    ("spectrum", ""),
    ("stats", ""),
    ("sobol", ""),
    ("sequence", "sequence"),
    ("noise_limit", ""),
    ("farm", "farm sequence"),
    ("sampling", "sobol space spectrum stats"),
    ("alias", ""),
    ("aov", ""),
    ("blackbody", "spectrum"),
    ("grid/brick", ""),
    ("grid/tree", "grid/brick space spectrum"),
    ("grid", "grid space"),
    ("vdb", "vdb grid/brick grid/tree space"),
    ("cache", "cache vdb grid space"),
    ("phase", "phase space spectrum sampling"),
    ("camera", "space spectrum sampling"),
    ("light", "light alias space spectrum sampling"),
    ("film", "film aov space spectrum stats"),
    ("field", "grid space spectrum"),
    (
        "emission",
        "emission field blackbody alias sampling space spectrum",
    ),
    (
        "medium",
        "space spectrum sampling stats phase grid field emission",
    ),
    ("silhouette", "camera medium grid"),
    ("tracking", "tracking space spectrum sampling stats medium"),
    (
        "integrator",
        "integrator tracking medium emission phase light space spectrum sampling stats",
    ),
    (
        "scene",
        "scene sequence vdb cache grid field aov blackbody emission medium phase light camera film \
         space spectrum sampling integrator tracking",
    ),
    (
        "plan",
        "scene vdb grid aov emission medium phase light camera space spectrum sampling integrator \
         tracking",
    ),
    (
        "render",
        "scene plan silhouette camera integrator film aov sampling stats light medium space spectrum",
    ),
    (
        "verify",
        "verify render scene camera integrator tracking medium grid vdb phase light film sampling \
         stats spectrum space",
    ),
    ("output", "output film aov camera stats spectrum space"),
    ("plot", ""),
    (
        "converge",
        "converge scene integrator tracking render film sampling stats output plot",
    ),
    (
        "cli",
        "cli space spectrum stats sampling aov grid vdb cache phase camera light film medium tracking \
         integrator sequence farm noise_limit scene plan render silhouette output converge verify",
    ),
];

/// Words that only some modules may say, with the reason.
const RESERVED: &[(&[&str], &[&str], &str)] = &[
    (
        &["std::fs", "fs::", "File::", "tempfile::"],
        &["vdb", "cache", "scene", "output", "cli", "main"],
        "touches the file system",
    ),
    (
        &["memmap2::"],
        // Values are bytes of a map, of memory or of a file that others opened; cells of large
        // grids are in one for its large pages.
        &["vdb", "grid/values", "grid/sections", "grid/cells"],
        "maps memory",
    ),
    (
        &["rayon::", "std::thread", "thread::"],
        // `cli` sizes the pool, once, before anything runs in it.
        &[
            "vdb",
            "cache",
            "render",
            "grid/blocks",
            "grid/bounds",
            "grid/encoding",
            "grid/values",
            "emission",
            "verify",
            "cli",
        ],
        "starts threads",
    ),
    (
        &["println!", "eprintln!", "print!", "eprint!", "dbg!"],
        &["cli", "main"],
        "prints",
    ),
    (
        &[
            "process::exit",
            "thread_local!",
            "static mut",
            "LazyLock",
            "OnceLock",
        ],
        &["main"],
        "keeps global state or ends the process",
    ),
    (&["unsafe"], &["vdb/file"], "is unsafe"),
];

/// Longest file allowed, in lines.
const MAX_LINES: usize = 800;

/// A source file: its module (`grid/tree`; `grid` for the façade) and text.
struct Source {
    path: String,
    module: String,
    text: String,
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn sources() -> Vec<Source> {
    let src = root().join("src");
    let mut folders = vec![src.clone()];
    let mut found = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("src/ can be listed") {
            let path = entry.expect("src/ can be listed").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let relative = path.strip_prefix(&src).expect("found below src/");
                let relative = relative
                    .to_str()
                    .expect("source files have plain names")
                    .replace('\\', "/");
                let module = relative.trim_end_matches(".rs").trim_end_matches("/mod");
                found.push(Source {
                    path: format!("src/{relative}"),
                    module: module.to_owned(),
                    text: std::fs::read_to_string(&path).expect("source files are UTF-8"),
                });
            }
        }
    }
    assert!(found.len() > 5, "src/ was not found where it should be");
    found.sort_by(|a, b| a.path.cmp(&b.path));
    found
}

/// Returns whether `module` is `scope` or lies in the folder `scope`.
fn within(module: &str, scope: &str) -> bool {
    module
        .strip_prefix(scope)
        .is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

/// Returns the row of the table that counts for a module: the longest that it lies within.
fn row(module: &str) -> Option<&'static (&'static str, &'static str)> {
    TABLE
        .iter()
        .filter(|(name, _)| within(module, name))
        .max_by_key(|(name, _)| name.len())
}

fn may_use(from: &str, to: &str) -> bool {
    match from {
        "lib" | "main" => true,
        _ => row(from)
            .is_some_and(|(_, uses)| from == to || uses.split_whitespace().any(|u| within(to, u))),
    }
}

fn modules(sources: &[Source]) -> Modules {
    Modules::new(sources.iter().map(|s| (&*s.module, &*s.text)))
}

fn forbidden_edges(source: &Source, modules: &Modules) -> Vec<String> {
    let Source { path, module, text } = source;
    modules
        .used_by(module, text)
        .into_iter()
        .filter(|(_, to)| !may_use(module, to))
        .map(|(line, to)| format!("{path}:{line}: `{module}` may not use `{to}`"))
        .collect()
}

fn reserved_words(source: &Source) -> Vec<String> {
    let Source { path, module, text } = source;
    let mut found = Vec::new();
    for (i, line) in production_code(text).lines().enumerate() {
        for (words, allowed, what) in RESERVED {
            if allowed.iter().any(|a| within(module, a)) {
                continue;
            }
            let says = |word: &&&str| {
                line.match_indices(**word).any(|(at, _)| {
                    let bare =
                        |x: Option<char>| !x.is_some_and(|x| x.is_alphanumeric() || x == '_');
                    let ends_a_word = word.ends_with(|x: char| x.is_alphanumeric());
                    bare(line[..at].chars().next_back())
                        && (!ends_a_word || bare(line[at + word.len()..].chars().next()))
                })
            };
            if let Some(word) = words.iter().find(says) {
                let line = i + 1;
                found.push(format!(
                    "{path}:{line}: `{word}` {what}; only {allowed:?} may"
                ));
            }
        }
    }
    found
}

fn report(violations: &[String]) -> String {
    violations.iter().fold(String::new(), |mut out, v| {
        let _ = write!(out, "\n  {v}");
        out
    })
}

#[test]
fn modules_use_only_what_the_table_allows() {
    let sources = sources();
    let modules = modules(&sources);
    let violations: Vec<_> = sources
        .iter()
        .flat_map(|s| forbidden_edges(s, &modules))
        .collect();
    assert!(violations.is_empty(), "{}", report(&violations));
}

#[test]
fn every_module_has_a_row() {
    let lost: Vec<_> = sources()
        .into_iter()
        .filter(|s| !["lib", "main"].contains(&&*s.module) && row(&s.module).is_none())
        .map(|s| format!("{}: not in the table of tests/architecture.rs", s.path))
        .collect();
    assert!(lost.is_empty(), "{}", report(&lost));
}

#[test]
fn the_table_has_no_cycles() {
    for (i, (module, uses)) in TABLE.iter().enumerate() {
        for used in uses.split_whitespace() {
            let at = TABLE.iter().position(|(name, _)| *name == used);
            let at = at.unwrap_or_else(|| panic!("`{module}` uses `{used}`, which has no row"));
            assert!(at <= i, "`{module}` stands above `{used}`, which it uses");
        }
    }
}

#[test]
fn files_threads_and_the_terminal_belong_to_few() {
    let violations: Vec<_> = sources().iter().flat_map(reserved_words).collect();
    assert!(violations.is_empty(), "{}", report(&violations));
}

#[test]
fn every_file_says_what_it_is_for_and_stays_short() {
    let mut violations = Vec::new();
    for Source { path, text, .. } in sources() {
        if !text.starts_with("//! ") {
            violations.push(format!("{path}:1: starts without a `//!` line"));
        }
        let lines = text.lines().count();
        if lines > MAX_LINES {
            violations.push(format!(
                "{path}: {lines} lines, more than {MAX_LINES}: two ideas?"
            ));
        }
    }
    assert!(violations.is_empty(), "{}", report(&violations));
}

#[test]
fn every_cited_reference_is_listed() {
    let references = std::fs::read_to_string(root().join("docs/references.md")).unwrap();
    let mut cited = 0;
    let mut violations = Vec::new();
    for Source { path, text, .. } in sources() {
        for (i, line) in text.lines().enumerate() {
            for part in line.split('[').skip(1) {
                let key = part.split(']').next().unwrap_or_default();
                let name = key.trim_end_matches(|x: char| x.is_ascii_digit());
                let is_key = key.len() == name.len() + 4
                    && name.starts_with(|x: char| x.is_ascii_uppercase())
                    && name.chars().all(char::is_alphabetic);
                if is_key {
                    cited += 1;
                    if !references.contains(&format!("\n### {key}\n")) {
                        let line = i + 1;
                        violations.push(format!(
                            "{path}:{line}: [{key}] is not in docs/references.md"
                        ));
                    }
                }
            }
        }
    }
    assert!(violations.is_empty(), "{}", report(&violations));
    assert!(cited > 0, "the scanner finds no citation at all");
}

#[test]
fn the_scanner_finds_planted_violations() {
    let facade = "pub mod brick;\npub use tree::{Tile, Tree};\n";
    let modules = Modules::new(
        [
            ("space", ""),
            ("grid", facade),
            ("grid/tree", ""),
            ("grid/brick", ""),
            ("light", ""),
            ("medium", ""),
        ]
        .into_iter(),
    );
    let edges = |module: &str, text: &str| {
        let source = Source {
            path: "x.rs".to_owned(),
            module: module.to_owned(),
            text: text.to_owned(),
        };
        forbidden_edges(&source, &modules)
    };
    let one = |line: usize, from: &str, to: &str| {
        vec![format!("x.rs:{line}: `{from}` may not use `{to}`")]
    };

    let plain = "//! x\nuse crate::space::Ray;\nuse crate::light::Lights;\n";
    assert_eq!(edges("grid/tree", plain), one(3, "grid/tree", "light"));
    let inline = "fn f() -> f32 {\n    crate::medium::g()\n}\n";
    assert_eq!(edges("grid", inline), one(2, "grid", "medium"));
    let nested = "use crate::{\n    grid::{tree::{self, Tree}, Brick},\n    light,\n};\n";
    assert_eq!(edges("medium", nested), one(1, "medium", "light"));
    let upwards = "use super::tree::Tree;\n";
    assert_eq!(
        edges("grid/brick", upwards),
        one(1, "grid/brick", "grid/tree")
    );
    assert_eq!(edges("grid/bounds", upwards), Vec::<String>::new());
    let far = "use super::super::light::Lights;\n";
    assert_eq!(edges("grid/tree", far), one(1, "grid/tree", "light"));
    let through_the_root = "use crate::Lights;\n";
    assert_eq!(edges("grid", through_the_root), one(1, "grid", "lib"));

    let through_a_facade = "use crate::grid::Tree;\n";
    assert_eq!(
        edges("grid/brick", through_a_facade),
        one(1, "grid/brick", "grid/tree")
    );
    assert_eq!(edges("vdb", through_a_facade), Vec::<String>::new());

    let innocent = "// crate::light\nconst A: &str = \"crate::light\"; const B: char = '\"';\n\
                    const C: &str = r#\"crate::light \" \"#;\nfn f<'a>(x: &'a u8) -> &'a u8 { x }\n\
                    #[cfg(test)]\nmod tests {\n    use crate::light::Lights;\n}\n";
    assert_eq!(edges("grid", innocent), Vec::<String>::new());
    let after_tests = format!("{innocent}use crate::light::Lights;\n");
    assert_eq!(edges("grid", &after_tests), one(9, "grid", "light"));
}

#[test]
fn the_scanner_finds_planted_words() {
    let found = |module: &str, text: &str| {
        reserved_words(&Source {
            path: "x.rs".to_owned(),
            module: module.to_owned(),
            text: text.to_owned(),
        })
        .len()
    };
    assert_eq!(
        found(
            "grid/tree",
            "use rayon::prelude::*;\nlet f = File::open(p);\n"
        ),
        2
    );
    assert_eq!(
        found(
            "vdb/decode",
            "use rayon::prelude::*;\nlet f = File::open(p);\n"
        ),
        0
    );
    assert_eq!(
        found(
            "render",
            "println!();\nunsafe { f() }\n// unsafe println!\n"
        ),
        2
    );
    assert_eq!(found("vdb/file", "unsafe { f() }\n"), 0);
    assert_eq!(found("film", "let unsafe_count = MyFile::new();\n"), 0);
}
