//! Finds the table of blocks of an OpenEXR file, by which it is known whether its last block is there.

use ::exr::meta::BlockDescription;

use super::read_meta;

/// Where a file lists its blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::io) struct BlockTable {
    /// Where the table begins, in bytes.
    pub(in crate::io) start: u64,
    /// How many blocks it lists.
    pub(in crate::io) blocks: usize,
    /// Bytes that stand in a block before its length; unknown where a file has several parts.
    pub(in crate::io) before_length: Option<u64>,
}

/// The table of the file that starts with `bytes`; none where these are not a whole header.
pub(in crate::io) fn block_table_of_head(bytes: &[u8]) -> Option<BlockTable> {
    let (meta, start) = read_meta(bytes).ok()?;
    let before_length = match &meta.headers[..] {
        [header] if !meta.requirements.is_multilayer() => Some(match header.blocks {
            BlockDescription::ScanLines => 4,
            BlockDescription::Tiles(_) => 16,
        }),
        _ => None,
    };
    let blocks = meta.headers.iter().map(|header| header.chunk_count).sum();
    Some(BlockTable { start: start as u64, blocks, before_length })
}
