#!/bin/busybox sh
# The guest's first program: modules, the host's files with a layer in memory over them, then the command.
b=/bin/busybox
$b mount -t proc proc /proc
$b mount -t sysfs sysfs /sys
$b mount -t devtmpfs dev /dev
while read -r name; do
    $b insmod "/modules/$name.ko" || echo "init: module $name does not load"
done </modules/order
share="trans=virtio,version=9p2000.L,msize=512000"
$b mount -t 9p -o "$share,ro,cache=loose" host /host
$b mount -t 9p -o "$share,cache=none" out /out
$b mount -t tmpfs changes /changes
$b mkdir -p /changes/upper /changes/work
$b mount -t overlay -o lowerdir=/host,upperdir=/changes/upper,workdir=/changes/work files /root
for folder in proc sys dev; do $b mount --move /$folder /root/$folder; done
$b mkdir -p /root/dev/pts /root/dev/shm /root/run
$b mount -t devpts devpts /root/dev/pts
$b mount -t tmpfs shm /root/dev/shm
$b mount -t tmpfs run /root/run
$b mkdir -p /root/run/out
$b mount --move /out /root/run/out
$b mount -t configfs configfs /root/sys/kernel/config
$b ip link set lo up
$b mkdir -p /root/run/bin /root/run/udev/rules.d
$b cp /bin/* /root/run/bin/
$b cp /root/run/bin/udevadm /root/run/bin/systemd-udevd
LD_LIBRARY_PATH=/run/bin $b chroot /root /run/bin/systemd-udevd --daemon
$b chroot /root /run/bin/busybox sh /run/out/command </root/dev/null >/root/dev/ttyS1 2>&1
echo $? >/root/run/out/code
$b sync
echo b >/root/proc/sysrq-trigger # qemu ends, told not to boot again
$b sleep 30
