from .urls import (
    RemoteNote as RemoteNote,
    RemotePath as RemotePath,
    is_url as is_url,
    limit_downloads as limit_downloads,
    make_path as make_path,
)
