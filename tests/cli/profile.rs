//! `majorant profile`: its page needs nothing else, and its numbers are those of a render.

use std::path::Path;

use crate::support::{Folder, code, majorant, stderr, stdout};
use serde_json::Value;

fn data_file(name: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    root.join("data").join(name).display().to_string()
}

/// Writes a scene of the cloud with a sun and a sky.
pub(crate) fn scene(folder: &Folder, more: &str) -> String {
    let volume = data_file("cloud.vdb");
    let text = format!(
        "[camera]\nposition = [0.6, -3.4, 0]\nlook_at = [0, 0, 0]\nvertical_fov_degrees = 24\n[[volume]]\nfile = {volume:?}\n\
         density = {{ scale = 84.0 }}\nphase = {{ type = \"henyey-greenstein\", g = 0.7 }}\n\
         {more}[[light]]\ntype = \"distant\"\ndirection_to_light = [1, 0, 1]\nirradiance = [3, 3, 3]\n\
         [[light]]\ntype = \"constant\"\nradiance = [1, 1, 1]\n[render]\nspp = 3\n"
    );
    folder.write("scene.toml", &text)
}

/// Returns the JSON that a page holds.
fn data(page: &str) -> Value {
    const BEGIN: &str = "<script type=\"application/json\" id=\"data\">";
    let begin = page.find(BEGIN).expect("the page has data") + BEGIN.len();
    let length = page[begin..].find("</script>").expect("and they end");
    serde_json::from_str(&page[begin..begin + length]).expect("they are JSON")
}

/// Checks what must hold of every profile; `counted` is a render's `--stats-json`.
fn check(profile: &Value, counted: &Value) {
    assert_eq!(profile["stats"]["counts"], counted["counts"], "exact");
    let work = profile["work"].as_array().expect("a list");
    let of = |work: &Value, key: &str| work[key].as_f64().expect("a number");
    assert_eq!(work.len(), 5, "four kinds and the rest");
    let total: f64 = work.iter().map(|w| of(w, "share")).sum();
    assert!((total - 1.0).abs() < 1e-9, "all of the time: {total}");
    let path = profile["nanoseconds_per_path"].as_f64().expect("a number");
    for one in work {
        let product = of(one, "events_per_path") * of(one, "nanoseconds");
        let said = of(one, "nanoseconds_per_path");
        assert!((product - said).abs() <= 1e-9 * path, "{one}");
        assert!(
            (said - of(one, "share") * path).abs() <= 1e-9 * path,
            "{one}"
        );
    }
    let measured = &profile["measured"];
    let number = |key: &str| measured[key].as_u64().expect("a count");
    // Work is what was counted in the tiles, in which every path has a camera ray.
    let per_path =
        measured["counts"]["segments"].as_f64().expect("a count") / number("paths") as f64;
    let said = of(&work[1], "events_per_path");
    assert!((said - per_path).abs() < 1e-9, "{said} for {per_path}");
    let rays = measured["counts"]["camera_rays"].as_u64();
    assert!(rays >= Some(number("paths")), "{rays:?}");
    // A memory of more bricks finds no less; nothing is found that was not read.
    let reuse = &measured["reuse"];
    let found: Vec<_> = reuse["found"]
        .as_array()
        .expect("a list")
        .iter()
        .map(Value::as_u64)
        .collect();
    assert!(found.is_sorted(), "{found:?}");
    assert!(found.last() <= Some(&reuse["reads"].as_u64()), "{reuse}");
    assert_eq!(profile["machine_counters"]["read"], false, "it says so");
}

#[test]
fn a_profile_has_the_counts_of_a_render_and_needs_nothing_else() {
    let folder = Folder::new();
    let (page, stats, image) = (
        folder.path("p.html"),
        folder.path("s.json"),
        folder.path("i.exr"),
    );
    let scene = scene(&folder, "");
    let run = majorant(&[
        "profile", &scene, "-r", "40x24", "-o", &page, "--json", "-j", "2",
    ]);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let run_again = majorant(&[
        "render",
        &scene,
        "-r",
        "40x24",
        "-o",
        &image,
        "--stats-json",
        &stats,
    ]);
    assert_eq!(code(&run_again), 0, "{}", stderr(&run_again));
    let read = |path: &str| std::fs::read_to_string(path).expect("written");
    let page = read(&page);
    let counted: Value = serde_json::from_str(&read(&stats)).expect("JSON");
    assert!(counted["counts"]["lookups"].as_u64() > Some(1000));
    let profile = data(&page);
    let printed: Value = serde_json::from_str(&stdout(&run)).expect("JSON");
    assert_eq!(profile, printed);
    check(&profile, &counted);
    let reads = &profile["measured"]["reuse"]["reads"];
    assert!(reads.as_u64() > Some(1000), "{reads}");
    // The image and two maps, all in the page; no script but the data, and no address of a network.
    assert_eq!(page.matches("src=\"data:image/png;base64,").count(), 3);
    assert_eq!(
        (
            page.matches("src=").count(),
            page.matches("<script").count()
        ),
        (3, 1)
    );
    assert!(!page.contains("://") && !page.contains("<link") && !page.contains("@import"));
}

#[test]
fn media_that_absorb_overlap_or_have_a_colour_are_profiled_too() {
    let folder = Folder::new();
    let volume = data_file("smoke.vdb");
    let second = format!("[[volume]]\nfile = {volume:?}\n");
    for more in [
        "albedo = [0, 0, 0]\n",
        "extinction_color = [1, 0.5, 0.25]\n",
        &second,
    ] {
        let (stats, image) = (folder.path("s.json"), folder.path("i.exr"));
        let scene = scene(&folder, more);
        let run = majorant(&["profile", &scene, "-r", "16x9", "--json"]);
        assert_eq!(code(&run), 0, "{more}: {}", stderr(&run));
        let again = majorant(&[
            "render",
            &scene,
            "-r",
            "16x9",
            "-o",
            &image,
            "--stats-json",
            &stats,
        ]);
        assert_eq!(code(&again), 0, "{more}: {}", stderr(&again));
        let counted = std::fs::read_to_string(&stats).expect("written");
        let counted: Value = serde_json::from_str(&counted).expect("JSON");
        let profile: Value = serde_json::from_str(&stdout(&run)).expect("JSON");
        check(&profile, &counted);
    }
}
