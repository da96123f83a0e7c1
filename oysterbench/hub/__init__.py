"""Distribution of splits without losing a byte: a static, content-addressed tree, its server and its client.

```
DIR/index.json                 mutable, small, signed: names manifests       (`index`, `sign`)
    manifests/<sha256>.json    immutable: names files, pieces and content    (`manifest`, `content`)
    blobs/<sha256>             immutable: the sequence files
    croissant/<sha256>.json    for search engines                            (`croissant`)
    pictures/<sha256>.jpg      frames for the page                           (`pages`)
    index.html
```

`publish` writes the tree, `serve` serves it, and so does any static web server, object store or shared folder;
`download` reads it through `sources`. A client trusts a key, never a server.
"""
