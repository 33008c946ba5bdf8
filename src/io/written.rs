//! Tells whoever wants to know of every file that was written whole.

use std::path::Path;
use std::sync::{PoisonError, RwLock};

type Listener = Box<dyn Fn(&Path) + Send + Sync>;

static LISTENER: RwLock<Option<Listener>> = RwLock::new(None);

/// How folders are named as long as they are not published.
const UNPUBLISHED: &str = ".partial";

/// Tells `listener` from now on of each file that this process has written whole, and of each folder that it has published;
/// it takes the place of an earlier one, and is called by whichever thread writes. Logs, which grow, are not told of.
pub fn tell_of_files(listener: impl Fn(&Path) + Send + Sync + 'static) {
    *LISTENER.write().unwrap_or_else(PoisonError::into_inner) = Some(Box::new(listener));
}

/// Tells of a file, unless it lies in a folder that is still to be published.
pub(super) fn tell(path: &Path) {
    let is_unpublished = path.iter().any(|part| part.to_string_lossy().ends_with(UNPUBLISHED));
    if !is_unpublished && let Some(listener) = &*LISTENER.read().unwrap_or_else(PoisonError::into_inner) {
        listener(path);
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;
    use std::sync::{Arc, Mutex};

    use super::*;
    use crate::io::{create_folder, publish, write_atomically};

    /// Other tests write beside this one: only files of its own folder count.
    #[test]
    fn files_are_told_of_when_they_are_whole_and_have_their_name() {
        let root = tempfile::tempdir().unwrap();
        let (told, own) = (Arc::new(Mutex::new(Vec::<PathBuf>::new())), root.path().to_owned());
        let listener = Arc::clone(&told);
        tell_of_files(move |path| {
            if let Ok(name) = path.strip_prefix(&own) {
                listener.lock().unwrap().push(name.to_owned());
            }
        });
        let write = |name: &str, is_good: bool| {
            write_atomically(&root.path().join(name), false, |file| match is_good {
                true => file.write_all(b"a"),
                false => Err(std::io::Error::other("no")),
            })
        };
        write("a", true).unwrap();
        write("a", true).unwrap_err();
        write("b", false).unwrap_err();
        create_folder(&root.path().join("c.partial")).unwrap();
        write("c.partial/d", true).unwrap();
        publish(&root.path().join("c.partial"), &root.path().join("c")).unwrap();
        assert_eq!(*told.lock().unwrap(), [PathBuf::from("a"), PathBuf::from("c")]);
    }
}
